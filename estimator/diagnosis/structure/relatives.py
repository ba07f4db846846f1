"""How probable it is that a cause only resembles something that no list holds.

Whatever is not in the library but looks like a cause of it leaves a trace beside that cause: a curve at most as large as what the cause
explains, and rarely much smaller. The evidence for such a curve, beside the cause, is that for a relative of the cause. A small effect
leaves it open; a large one, cleanly explained, rules it out.

Scatter changes no prediction. The misses of what resembles a cause of it are spread otherwise (`structure.scatter`); that they are not
rules nothing out, for a few late triggers lie like a few dropped bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import Projector, log_mean_exp
from estimator.diagnosis.structure.discrepancy import (
    Batches,
    by_name,
    evidence_by_amplitude,
    expected_of_noise,
    products_of,
)
from estimator.diagnosis.structure.families.collection import Family
from estimator.diagnosis.structure.scatter import scatter_of
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Unknown:
    """What no list holds, beside a cause.

    Attributes:
        probability: That it is there instead of the cause.
        most_beside: Probability up to which the name of the cause is stated alone.
    """

    probability: float
    most_beside: float = policy.MOST_BESIDE_A_NAME


def unknown_beside(fit: Fit, causes: Sequence[Cause], families: Sequence[Family]) -> list[Unknown]:
    """For each cause the probability that something outside the library is there instead of it, and how much of that a name bears.

    A credible set of 95 % holds what has more than 5 %. Even a true cause leaves more where it is not large: as much as noise is
    expected to leave to relatives of that size, and a little more by chance.

    Args:
        fit: With the causes.
        causes: Some of its rig.
        families: Curves, weighed as at that fit.
    """
    scattering = [cause for cause in causes if isinstance(EFFECTS[cause.name], NoiseEffect)]
    rms = {cause: visible_rms_sigma(fit, cause) for cause in causes if cause not in scattering}
    amplitudes = [share * size for size in rms.values() for share in policy.RELATIVE_SHARES]
    batches = products_of(fit, families) if amplitudes else []
    # Of all causes at once, so that the directions of each family are found once.
    evidence = evidence_by_amplitude(fit, families, amplitudes, batches)
    each = zip(evidence.split(len(policy.RELATIVE_SHARES), dim=1), rms.items(), strict=True) if rms else ()
    unknown = {cause: _beside(fit, families, own, size, batches) for own, (cause, size) in each}
    for cause in scattering:
        unknown[cause] = Unknown(_probability(max(scatter_of(fit).log_bayes_factor, 0.0)))
    return [unknown[cause] for cause in causes]


def _beside(
    fit: Fit,
    families: Sequence[Family],
    evidence: Float[Tensor, "family share"],
    rms_sigma: float,
    batches: Batches,
) -> Unknown:
    """What no list holds beside one cause, given the evidence for relatives of its size."""
    probability = _probability(_mean(families, evidence))
    if not policy.LEAST_BESIDE_A_NAME < probability <= policy.MOST_BESIDE_A_NAME:
        return Unknown(probability)  # on the same side of any limit
    amplitudes = [share * rms_sigma for share in policy.RELATIVE_SHARES]
    of_noise = _mean(families, expected_of_noise(fit, families, amplitudes, batches))
    limit = _probability(of_noise + policy.MORE_THAN_OF_NOISE)
    return Unknown(probability, min(max(limit, policy.LEAST_BESIDE_A_NAME), policy.MOST_BESIDE_A_NAME))


def _mean(families: Sequence[Family], evidence: Float[Tensor, "family amplitude"]) -> float:
    """Log evidence that one of the families is there, whichever it is."""
    return log_mean_exp(torch.tensor(list(by_name(families, evidence).values()), dtype=torch.float64))


def _probability(log_bayes_factor: float) -> float:
    """Probability of what is in no list, given its evidence against what is."""
    log_odds = log_bayes_factor + math.log(policy.PRIOR_OUTSIDE / (1.0 - policy.PRIOR_OUTSIDE))
    return 1.0 / (1.0 + math.exp(-min(max(log_odds, -700.0), 700.0)))


def visible_rms_sigma(fit: Fit, cause: Cause) -> float:
    """Rms of what a cause changes in the readings beyond what the rest of the fit can follow, in units of the noise."""
    posterior, prefix = fit.posterior, f"{cause.label}."
    with torch.no_grad():
        without_T = posterior.model.predict({**fit.values, **fit.null_values(cause)}).expand(
            len(fit.observations), 3
        )
        change_T = posterior.predicted(fit.vector) - posterior.measured_components(without_T)
    others = [i for i, name in enumerate(posterior.coordinates.names) if not name.startswith(prefix)]
    prior = (fit.optimum.precision - fit.optimum.information)[0][others][:, others]
    rest = Projector.of(fit.jacobian[:, others], prior).rest(change_T * fit.whitening_per_T)
    return float(rest.square().mean().sqrt())

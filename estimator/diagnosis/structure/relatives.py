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

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import Projector, log_mean_exp
from estimator.diagnosis.structure.discrepancy import by_name, evidence_by_amplitude
from estimator.diagnosis.structure.families.collection import Family
from estimator.diagnosis.structure.scatter import scatter_of
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
from estimator.rig.rig import Cause


def p_not_in_library(fit: Fit, cause: Cause, families: Sequence[Family]) -> float:
    """Probability that something outside the library is there instead of a cause that resembles it.

    Args:
        fit: With the cause.
        cause: One of its rig.
        families: Curves, weighed as at that fit.
    """
    if isinstance(EFFECTS[cause.name], NoiseEffect):
        log_odds = max(scatter_of(fit).log_bayes_factor, 0.0)
    else:
        rms_sigma = visible_rms_sigma(fit, cause)
        amplitudes = [share * rms_sigma for share in policy.RELATIVE_SHARES]
        evidence = by_name(families, evidence_by_amplitude(fit, families, amplitudes))
        log_odds = log_mean_exp(torch.tensor(list(evidence.values()), dtype=torch.float64))
    log_odds += math.log(policy.PRIOR_OUTSIDE / (1.0 - policy.PRIOR_OUTSIDE))
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

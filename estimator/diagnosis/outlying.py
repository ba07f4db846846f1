"""Readings that are probably outliers, where the fit says that a share of the readings is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.calibration.policy import LARGER_THAN_NOISE
from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.instants import are_on_known_sides
from estimator.diagnosis.row_mistakes import FACTORS
from estimator.effects.stages import NoiseEffect
from estimator.effects.use import as_meant, uses_of
from estimator.inference.likelihood import LogPosterior
from estimator.readings.flags import COMPONENTS
from estimator.readings.observations import Observations
from estimator.rig.parameters import LogNormal

PROBABLY = 0.5
MOST_SETTINGS = 30  # currents of a session that are tried in place of those that were written down
MOST_TOLD = 100  # components for which they are tried
WIDTH_OF_ONE = 20.0  # standard deviations of the noise, of the errors of a single component


@dataclass(frozen=True)
class Outlier:
    """A component of a reading that is probably wrong.

    Attributes:
        reading: Number of the reading in the session, from 0.
        sensor: Name of its sensor.
        component: Index of the component.
        miss_T: Measured less predicted.
        miss_sd: The same in standard deviations of the readings that are right.
        probability: That it is wrong.
        words: How it may have been written down so, as a clause: a decimal point beside its place, a sign, another current; empty
            where nothing tells.
        line: Line of the file from which it was imported; None where there is no such file.
    """

    reading: int
    sensor: str
    component: int
    miss_T: float
    miss_sd: float
    probability: float
    words: str = ""
    line: int | None = None

    def to_json(self) -> dict[str, Any]:
        """The outlier in the form of JSON; readings are counted from 1."""
        return asdict(self) | {"reading": self.reading + 1, "component": COMPONENTS[self.component]}


def outliers_of(fit: Fit, observations: Observations, leaves_something: bool) -> list[Outlier]:
    """Components that are probably outliers, those that miss most first.

    Each is wrong with the probability of the fit's mixture: the share that is wrong, and how wide its errors are. Where the rig of the
    fit has no outliers, one component of the session is expected to be wrong, by many times the noise.

    Args:
        fit: Of the rig.
        observations: The readings, a whole session.
        leaves_something: The rig does not explain all readings. Then a component is wrong only if it is far off, and the rig has outliers.
    References: Bayes' rule for a mixture of two normals, as in Hogg, Bovy and Lang, arXiv:1008.4686 (2010), section 3.
    """
    has_outliers = any(use.effect.is_contaminating for use in uses_of(fit.rig, NoiseEffect))
    leaves_something = leaves_something or _is_noisy(fit)
    if leaves_something and not has_outliers:
        return []
    observations = as_meant(fit.rig, observations)
    posterior = LogPosterior(fit.posterior.coordinates, fit.model_of(observations), observations)
    with torch.no_grad():
        miss_T = posterior.measured_T - posterior.predicted(fit.vector)
        miss_sd = miss_T / posterior.component_sigma_T(fit.vector)
        one_of_all = miss_sd.new_tensor(1.0 / len(miss_sd)), miss_sd.new_tensor(WIDTH_OF_ONE)
        share, ratio = posterior.contamination(fit.values) if has_outliers else one_of_all
        good = torch.log1p(-share) - 0.5 * miss_sd**2
        bad = torch.log(share / ratio) - 0.5 * (miss_sd / ratio) ** 2
        probability = torch.sigmoid(bad - good)
    # Where something moves readings that no cause explains, only what is far off is a mistake for sure.
    is_far = miss_sd.abs() > (policy.FAR_FROM_EXPECTED if leaves_something else 0.0)
    is_of_known_side = are_on_known_sides(fit, observations)[observations.is_measured.nonzero()[:, 0]]
    probable = ((probability > PROBABLY) & is_far & is_of_known_side).nonzero().flatten()
    probable = probable[miss_sd[probable].abs().argsort(descending=True)]
    readings, components = observations.is_measured.nonzero()[probable].unbind(1)
    names = [fit.rig.sensors[sensor].name for sensor in observations.sensor[readings].tolist()]
    numbers = (numbers[probable].tolist() for numbers in (miss_T, miss_sd, probability))
    measured_T, sigma_T = posterior.measured_T[probable], (miss_T / miss_sd)[probable]
    words = _written_as(measured_T, measured_T - miss_T[probable], sigma_T)
    if not all(words):
        fits = _with_other_currents(fit, observations, readings, components, measured_T, sigma_T)
        words = [word or other for word, other in zip(words, fits, strict=True)]
    lines = [None] * len(probable) if observations.line is None else observations.line[readings].tolist()
    return list(map(Outlier, readings.tolist(), names, components.tolist(), *numbers, words, lines))


def _is_noisy(fit: Fit) -> bool:
    """Whether a sensor scatters clearly more than its rig file expects: then something unknown moves its readings, not mistakes alone."""
    noises = [fit.rig.parameters[f"{sensor.name}.noise_T"] for sensor in fit.rig.sensors]
    return any(
        float(fit.values[noise.name]) > LARGER_THAN_NOISE * noise.prior.median
        for noise in noises
        if isinstance(noise.prior, LogNormal) and noise.name in fit.values
    )


def _written_as(
    measured_T: Float[Tensor, " component"],
    predicted_T: Float[Tensor, " component"],
    sigma_T: Float[Tensor, " component"],
) -> list[str]:
    """The factor by which each component comes nearest to what is predicted, in words, where it explains one by more than its errors."""
    factors = measured_T.new_tensor(list(FACTORS))[:, None]
    error_T = factors.abs().clamp(min=1.0) * sigma_T
    would_show = ((factors - 1.0) * predicted_T).abs() > policy.FAR_FROM_EXPECTED * error_T
    off = ((measured_T - factors * predicted_T) / error_T).abs().masked_fill(~would_show, torch.inf)
    least, nearest = off.min(dim=0)
    words = list(FACTORS.values())
    is_near = (least < policy.NEAR_TO_EXPECTED).tolist()
    return [words[i] if near else "" for i, near in zip(nearest.tolist(), is_near, strict=True)]


def _with_other_currents(
    fit: Fit,
    observations: Observations,
    readings: Int[Tensor, " component"],
    components: Int[Tensor, " component"],
    measured_T: Float[Tensor, " component"],
    sigma_T: Float[Tensor, " component"],
) -> list[str]:
    """The other currents of the session with which each component would fit, in words; empty where none would, or where they are many."""
    settings = observations.current_A.unique(dim=0)
    if len(settings) > MOST_SETTINGS:
        return [""] * len(readings)
    rows = observations.rows(readings[:MOST_TOLD])
    fields_T = []
    with torch.no_grad():
        for setting in settings:
            other = replace(rows, current_A=setting.expand_as(rows.current_A))
            predicted_T = fit.model_of(other).predict(fit.values).expand(len(rows), 3)
            fields_T.append(predicted_T.gather(1, components[:MOST_TOLD, None])[:, 0])
    off = ((torch.stack(fields_T) - measured_T[:MOST_TOLD]) / sigma_T[:MOST_TOLD]).abs()
    off[(settings[:, None] == rows.current_A).all(-1)] = torch.inf
    least, nearest = off.min(dim=0)
    names = [coil.name for coil in fit.rig.coils]
    words = [
        f"fits {_currents(names, settings[k])} where {_currents(names, written)} is written" if near else ""
        for k, near, written in zip(
            nearest.tolist(), (least < policy.NEAR_TO_EXPECTED).tolist(), rows.current_A, strict=True
        )
    ]
    return words + [""] * (len(readings) - len(words))


def _currents(names: Sequence[str], current_A: Float[Tensor, " coil"]) -> str:
    """Currents in words, of one coil without its name."""
    if len(names) == 1:
        return f"{float(current_A[0]):.4g} A"
    each = (f"{name} {value:.4g} A" for name, value in zip(names, current_A.tolist(), strict=True))
    return ", ".join(each)

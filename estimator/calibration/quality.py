"""Whether a calibration can be used: good, suspect or unusable, with the reasons and what to do next.

It compares what the fit leaves with the noise (that of readings at the same place, else that of the rig file), fitted numbers with their
priors, and halves of the session with each other. A fit follows what it can, so a good calibration may still hide something; `coilcal
diagnose` looks closer.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.special import bdtr

from estimator.calibration import policy
from estimator.calibration.halves import clearest_pattern, disagreements, unseen
from estimator.calibration.linear_fit import Disagreement, LinearFit
from estimator.calibration.next_degree import CLEAR_LOG_EVIDENCE
from estimator.calibration.result import Calibration
from estimator.effects import EFFECTS
from estimator.inference.noise_of_readings import noise_rms_T, noise_words, scatter_of_sensors
from estimator.reporting.numbers import displays, percent, size_with_unit
from estimator.rig.parameters import Parameter

MOST_OF_IT = 0.5  # share of the squared error from which on it is told to be that of one reading


class Quality(StrEnum):
    """Whether a calibration can be used; the words are stable (docs/file-formats.md)."""

    GOOD = "good"
    SUSPECT = "suspect"
    UNUSABLE = "unusable"


# What to do next.
DO_NOT_USE = (
    "Do not use it. "
    "Run coilcal diagnose, which asks for wrong signs, units and frames first, and then for what else is wrong."
)
RAISE_DEGREE = (
    "Raise `degree` in the rig file until readings ask for no higher one, "
    "or lower `margin` and `spacing` likewise, and calibrate again."
)
STILL_WRONG = (
    "With the causes that this rig has, something may still be wrong in it: do not rely on what lies far off."
)
ASK_FOR_CAUSES = (
    "Something in the rig file or in the model may be wrong; numbers, intervals and probabilities hold only if nothing is. "
    "Run coilcal diagnose, which names it or says that it cannot."
)
SAMPLE_ON = "Run the same command with more steps: it goes on from here."
LOOK_CLOSER = "Run coilcal diagnose to look closer for what a fit may have followed."


def condition(quality: Mapping[str, Any]) -> str:
    """Words that follow a probability, unless the calibration is good; by `quality` of a summary."""
    return "" if quality["verdict"] == Quality.GOOD else " if nothing is wrong"


@dataclass(frozen=True)
class Assessment:
    """Whether a calibration can be used.

    Attributes:
        reasons: Sentences, the weightiest first.
        next_step: What to do, in a sentence.
    """

    quality: Quality
    reasons: tuple[str, ...]
    next_step: str

    def to_json(self) -> dict[str, Any]:
        """Verdict, reasons and next step in the form of `summary.json`."""
        first, *others = self.reasons  # the first one follows the verdict and a colon
        reasons = [first, *(reason[:1].upper() + reason[1:] for reason in others)]
        return {"verdict": str(self.quality), "reasons": reasons, "next": self.next_step}


def assessment(
    calibration: Calibration,
    errors: Mapping[str, Any],
    next_degree_log_evidence: float | None = None,
    is_converged: bool = True,
) -> Assessment:
    """Judge a calibration by its errors, its noise and its priors.

    Args:
        calibration: Readings, draws and best values.
        errors: `rmse` and `coverage90` of its summary, by role; unseen readings count where there are any.
        next_degree_log_evidence: Of harmonics of one degree more in coils without a winding, where there are such coils.
        is_converged: Sampling has reached its targets.
    """
    role = "validation" if errors["rmse"]["validation"] else "calibration"
    missed, error_T = errors["rmse"][role]["relative"], errors["rmse"][role]["vector_T"]
    coverage90 = errors["coverage90"][role]
    rig, observations = calibration.rig, calibration.observations
    nominal, scatter = rig.nominal_values(), scatter_of_sensors(rig, observations.calibration)
    judged = observations.validation if role == "validation" else observations.calibration
    expected_T = noise_rms_T(rig, judged, nominal, scatter)
    noise = noise_words(bool(scatter))
    sizes = f"{_size(error_T)} where {noise} {_size(expected_T)}"
    if missed is not None and missed > policy.MISSED_SHARE and error_T > policy.MISSED_NOISE * expected_T:
        reason = f"the model misses {percent(missed)} of the field, {sizes}."
        return Assessment(Quality.UNUSABLE, (reason,), DO_NOT_USE)
    medians = {name: float(np.median(draws)) for name, draws in calibration.draws.items()}
    fit = LinearFit.of(rig, observations.calibration, calibration.best)
    misfit = _misfit(error_T, expected_T, noise)
    if not misfit and role == "validation":
        fitted_T = noise_rms_T(rig, observations.calibration, nominal, scatter)
        fitted_error_T = errors["rmse"]["calibration"]["vector_T"]
        misfit = _misfit(fitted_error_T, fitted_T, noise, " of the readings that were fitted")
    if misfit:
        misfit += _one_reading(fit)
    reasons = [
        *misfit,
        *_disagreement(fit),
        *_missed_unseen(fit, calibration),
        *tensions((p for p in rig.free if not p.name.endswith(".noise_T")), medians),
    ]
    if coverage90 is not None and is_too_few(coverage90, int(judged.is_measured.sum())):
        reasons.append(f"only {percent(coverage90)} of the readings' components lie in their 90 % intervals.")
    if (next_degree_log_evidence or 0.0) > CLEAR_LOG_EVIDENCE:
        reasons.append(
            f"a coil without a winding has a finer field than its degree allows ({next_degree_log_evidence:+.3g} in log evidence for one "
            "degree more, or for charges closer to the box), so its intervals are too narrow."
        )
        if len(reasons) == 1:
            return Assessment(Quality.SUSPECT, tuple(reasons), RAISE_DEGREE)
    reasons = reasons or _pattern(fit)
    if reasons:
        has_causes = any(not EFFECTS[cause.name].is_everywhere for cause in rig.acting)
        return Assessment(Quality.SUSPECT, tuple(reasons), STILL_WRONG if has_causes else ASK_FOR_CAUSES)
    if not is_converged:
        reason = "sampling did not converge, so its intervals are provisional."
        return Assessment(Quality.SUSPECT, (reason,), SAMPLE_ON)
    agreeing = (
        "halves of the session and unseen readings" if role == "validation" else "halves of the session"
    )
    reason = (
        f"it misses {_share(missed)} of the field, {sizes}, {agreeing} agree, no cause of the library shows clearly, and no number is far "
        "from what is expected."
    )
    return Assessment(Quality.GOOD, (reason,), LOOK_CLOSER)


def is_too_few(coverage90: float, n_components: int) -> bool:
    """Whether fewer components lie in their 90 % intervals than chance explains.

    Args:
        coverage90: Share of the components.
        n_components: How many there are; of one-axis readings there may be a dozen.

    Examples:
        >>> is_too_few(8 / 12, 12), is_too_few(5 / 12, 12), is_too_few(0.7, 60), is_too_few(0.8, 6000)
        (False, True, True, False)
    """
    by_chance = float(bdtr(round(coverage90 * n_components), n_components, 0.9))
    return coverage90 < policy.LEAST_COVERAGE90 and by_chance < policy.LEAST_AGREEMENT


def tensions(parameters: Iterable[Parameter], values: Mapping[str, float]) -> list[str]:
    """Sentences on numbers far from their priors, the farthest first; noise counts where it is too large.

    Args:
        parameters: Free ones.
        values: What was found for them, by name.
    """
    parameters = list(parameters)
    far = []
    shown = displays([parameter.name for parameter in parameters])
    for parameter in parameters:
        assert parameter.prior is not None
        value = values[parameter.name]
        distance_sd = parameter.prior.distance(value)
        is_noise = parameter.name.endswith(".noise_T")
        if is_noise and value <= policy.LARGER_THAN_NOISE * parameter.prior.centre:
            continue
        if is_noise or abs(distance_sd) > policy.FAR_SD:
            show = shown[parameter.name]
            size, middle = (f"{number * show.factor:.4g}" for number in (value, parameter.prior.centre))
            words = f"{show.words} is {size} {show.unit}".rstrip()
            how_far = f"{distance_sd:+.1f} widths of its prior"
            if is_noise and parameter.prior.centre > 0.0:
                how_far = f"{value / parameter.prior.centre:.2g} times as much"
            far.append((abs(distance_sd), f"{words} where {middle} is expected, {how_far}."))
    return [words for _, words in sorted(far, reverse=True)]


def _misfit(error_T: float, expected_T: float, noise: str, of_which: str = "") -> list[str]:
    """An error that the expected noise does not explain, known or free: a wide prior of the noise would follow any error."""
    if error_T <= policy.LARGER_THAN_NOISE * expected_T:
        return []
    ratio = math.inf if expected_T == 0.0 else error_T / expected_T
    return [f"the error{of_which} is {_size(error_T)}, {ratio:.2g} times what {noise} ({_size(expected_T)})."]


def _one_reading(fit: LinearFit) -> list[str]:
    """The reading that has most of the error of those that were fitted, where one has: a slip of the pen, a wrong current."""
    error_T = fit.residual[: len(fit.sigma_T)] * fit.sigma_T
    worst = int(error_T.abs().argmax())
    if float(error_T[worst] ** 2) <= MOST_OF_IT * float(error_T.square().sum()):
        return []
    observations = fit.posterior.model.circumstances.observations
    reading = int(observations.is_measured.nonzero()[worst, 0])
    line = "" if observations.line is None else f" (line {int(observations.line[reading])})"
    off = _size(abs(float(error_T[worst])))
    return [f"most of the error of the readings that were fitted is that of a single one{line}, {off} off."]


def _disagreement(fit: LinearFit) -> list[str]:
    """The half of the session that disagrees most with the rest."""
    return list(map(_told, filter(_is_clear, disagreements(fit)[:1])))


def _missed_unseen(fit: LinearFit, calibration: Calibration) -> list[str]:
    """Unseen readings, where there are any."""
    observations = calibration.observations.validation
    if not bool(observations.is_measured.any()):
        return []
    beyond = unseen(fit, LinearFit.of(calibration.rig, observations, calibration.best))
    return list(map(_told, filter(_is_clear, [beyond])))


def _pattern(fit: LinearFit) -> list[str]:
    """What a cause of the library would leave."""
    pattern = clearest_pattern(fit)
    return [] if pattern is None or not _is_clear(pattern) else [_told(pattern)]


def _is_clear(disagreement: Disagreement) -> bool:
    return disagreement.p_value < policy.LEAST_AGREEMENT


def _told(disagreement: Disagreement) -> str:
    return f"{disagreement.words} (probability {disagreement.p_value:.1g} by noise alone)."


def _size(field_T: float) -> str:
    return size_with_unit(field_T, "T", 3)


def _share(share: float | None) -> str:
    return "an unknown share" if share is None else percent(share, 2)

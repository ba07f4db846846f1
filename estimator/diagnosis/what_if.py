"""What a cause of some size would do to the readings of a session, to first order, and what the fit would leave of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import effort, policy
from estimator.diagnosis.drawing import outline_of, rounded
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.diagnosis.panel_records import Vectors, WindingOutline
from estimator.effects import EFFECTS
from estimator.errors import InvalidInput
from estimator.model.hide import cause_of
from estimator.model.measurement_model import MeasurementModel
from estimator.model.preflight import check_readings
from estimator.readings.split import thinned
from estimator.reporting.numbers import quantity_words
from estimator.store.session import Session

MOST_READINGS = 200


@dataclass(frozen=True)
class PossibleCause:
    """A cause that could be in the session."""

    label: str
    words: str
    kind: str


@dataclass(frozen=True)
class Pattern:
    """What one quantity of a cause does, for each unit of it in SI.

    Attributes:
        key, words: The quantity, with its unit and without.
        unit: Its unit in SI.
        typical: Standard deviation of its prior.
        visible: Size that changes the readings by five standard deviations beyond what the fit can follow; None where none does.
        left_sigma: Root mean square of what is left, in units of the noise.
        added_T: Field that it adds to each reading.
        left_T: What is left of that once all else has been fitted again.
    """

    key: str
    words: str
    unit: str
    typical: float
    visible: float | None
    left_sigma: float
    added_T: Vectors
    left_T: Vectors


@dataclass(frozen=True)
class WhatIf:
    """What a cause would do to a session.

    Attributes:
        label, words: The cause.
        coil: Coil in whose frame places and fields are.
        winding: Its outline; None for a coil without a winding.
        noise_T: Median noise of a component.
        position_m: Places of the sensor.
        patterns: Of each of its quantities.
    """

    label: str
    words: str
    coil: str
    winding: WindingOutline | None
    noise_T: float
    position_m: Vectors
    patterns: list[Pattern]


def fit_for_what_if(session: Session) -> Fit:
    """The fit of a session's rig to some of its readings.

    Raises:
        InvalidInput: The readings cannot support a fit.
    """
    rig = session.rig
    check_readings(rig, session.observations, session.source)
    few = thinned(session.observations.calibration, MOST_READINGS, 0)
    return fit_rig(rig, few, {}, MeasurementModel.build(rig, few).rules, effort.MORE_STARTS)


def possible_causes(fit: Fit) -> list[PossibleCause]:
    """Causes that the rig does not have and that concern the session."""
    return [
        PossibleCause(cause.label, EFFECTS[cause.name].words, str(EFFECTS[cause.name].kind))
        for cause in causes_of(fit.rig, fit)
    ]


def what_if(fit: Fit, label: str) -> WhatIf:
    """What one cause would do.

    Args:
        fit: Of `fit_for_what_if`.
        label: The cause, as `axis_gain[hall]`.
    Raises:
        InvalidInput: There is no such cause, or it does nothing to these readings.
    """
    cause = cause_of(label, fit.rig)
    pool = candidates(fit, [cause]) if cause in causes_of(fit.rig, fit) else []
    if not pool:
        raise InvalidInput(f"cause must be one that acts on the readings of the session; received {label!r}")
    best = max(
        pool, key=lambda candidate: float((fit.projector.rest(candidate.columns) * candidate.prior_sd).norm())
    )
    left = fit.projector.rest(best.columns)
    coil = fit.rig.coils[int(fit.observations.current_A.abs().sum(0).argmax())]
    position_m, coil_from_sensor = fit.posterior.model.readings_in_coil(coil, fit.values)

    def shown(column: Float[Tensor, " component"]) -> Vectors:
        field_T = torch.zeros(len(position_m), 3, dtype=torch.float64)
        field_T[fit.observations.is_measured] = column / fit.whitening_per_T.clamp(min=1e-30)
        return rounded((coil_from_sensor @ field_T[..., None])[..., 0])

    patterns = []
    for i, key in enumerate(best.keys):
        norm = float(left[:, i].norm())
        patterns.append(
            Pattern(
                key=key,
                words=quantity_words(key),
                unit=best.units[i],
                typical=float(best.prior_sd[i]),
                visible=policy.VISIBLE_SIGMA / norm if norm > 0.0 else None,
                left_sigma=norm / math.sqrt(len(left)),
                added_T=shown(best.columns[:, i]),
                left_T=shown(left[:, i]),
            )
        )
    return WhatIf(
        label=cause.label,
        words=EFFECTS[cause.name].words,
        coil=coil.name,
        winding=outline_of(fit, coil),
        noise_T=float((1.0 / fit.whitening_per_T).median()),
        position_m=rounded(position_m),
        patterns=patterns,
    )

"""Places at which to map a field, so that a correction of a wanted degree is determined."""

from __future__ import annotations

import torch

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.next_readings.expected_evidence import continued
from estimator.diagnosis.next_readings.stops import at_currents
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.corrections.correction import Correction
from estimator.errors import InvalidInput
from estimator.model.clearance import clearance_m
from estimator.model.hide import cause_of
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig

MAP_PLACES_ALONG_AXIS = 7  # of a ball: a field of fifth degree turns five times


def with_correction(fit: Fit, text: str, degree: int) -> tuple[Fit, list[str]]:
    """The fit with a correction of a degree, and the names of its amplitudes.

    Args:
        fit: Of the readings so far.
        text: The correction, as `coil_harmonics[coil1]`.
        degree: Highest degree of its terms.
    Raises:
        InvalidInput: It is no correction, the rig has it already, or it has no such degree.
    """
    cause = cause_of(text, fit.rig)
    effect = EFFECTS[cause.name]
    if not isinstance(effect, Correction):
        known = ", ".join(sorted(name for name, each in EFFECTS.items() if each.is_correction))
        raise InvalidInput(f"map must name a correction ({known}); received {text!r}")
    if cause in fit.rig.corrections:
        raise InvalidInput(f"{cause.label} must not be in the rig already to be mapped")
    if not effect.lowest <= degree <= effect.highest:
        raise InvalidInput(
            f"degree of {cause.name} must lie between {effect.lowest} and {effect.highest}; received {degree}"
        )
    circumstances = fit.circumstances
    degrees = range(effect.lowest, degree + 1)
    keys = [effect.key(each, term) for each in degrees for term in effect.terms(each)]
    values = {**effect.starts(circumstances, cause.place)[0], **dict.fromkeys(keys, 0.0)}
    rig = with_effect(fit.rig, cause, fit.observations, values)
    with_it = fit_rig(rig, fit.observations, fit.start_with(rig), fit.posterior.model.rules)
    return with_it, [f"{cause.label}.{key}" for key in keys]


def map_stops(session: Observations, rig: Rig) -> Observations:
    """Places that fill the ball about all places so far, at the largest current of each coil and without.

    The mover that went farthest visits them; everything else stays as at the reading nearest to the middle. No place is nearer to a
    winding than the nearest reading was.

    Raises:
        InvalidInput: No mover is told by positions, or none has moved.
    """
    cartesian = (MotionKind.POSE, MotionKind.DISPLACEMENT)
    movers = [mover.name for mover in rig.movers if mover.motion in cartesian]
    widths_m = {name: _width_m(session, name) for name in movers}
    mover = max(widths_m, key=widths_m.__getitem__, default=None)
    if mover is None or widths_m[mover] == 0.0:
        raise InvalidInput(
            "a map needs a mover that is told by positions and has moved; the session has none"
        )
    place_m = session.motion[mover][:, :3]
    low_m, high_m = place_m.amin(0), place_m.amax(0)
    middle_m = 0.5 * (low_m + high_m)
    steps = torch.linspace(-1.0, 1.0, MAP_PLACES_ALONG_AXIS, dtype=torch.float64)
    grid = torch.cartesian_prod(steps, steps, steps)
    ball = grid[grid.norm(dim=-1) <= 1.0]
    nearest = int((place_m - middle_m).norm(dim=-1).argmin())
    which, current_A = at_currents(session, torch.arange(len(ball)), (1.0, 0.0))
    rows = torch.full_like(which, nearest)
    columns = session.motion[mover][rows].clone()
    columns[:, :3] = middle_m + 0.5 * widths_m[mover] * ball[which]
    stops = continued(session, rows, current_A, {mover: columns})
    least_m = _clearance_m(rig, session).min()
    return stops.rows(_clearance_m(rig, stops) >= least_m)


def _width_m(session: Observations, mover: str) -> float:
    place_m = session.motion[mover][:, :3]
    return float((place_m.amax(0) - place_m.amin(0)).max())


def _clearance_m(rig: Rig, readings: Observations) -> torch.Tensor:
    return clearance_m(MeasurementModel.unruled(rig, readings))

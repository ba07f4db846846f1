"""Corrections of a sensor in time: how it responds, how it is turned, its zero, and what it keeps of readings before."""

from __future__ import annotations

import math

from jaxtyping import Float

from estimator.effects.base import Starts, Theta, box
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.bases import DURATION, Periodic, Steps, Swings, Table, Wanders
from estimator.effects.corrections.correction import RANGE_T, constants, correction
from estimator.effects.corrections.targets import Response, Turned, Zero
from estimator.effects.stages import Components
from estimator.frames import vector_from_rotation
from estimator.geometry.motion import base_from_motion
from estimator.tensors import Tensor, torch

SAME_ANGLE_RAD = 1e-3
LEAST_ANGLE_RAD = 0.1  # that a mover turns through
AXIS_DIGITS = 6
OFF_AXIS = 1e-3  # of the angles: a mover that turns about several axes is no rotary stage
AXIS = ("axis_x", "axis_y", "axis_z")


@correction(Response, Wanders, scales=(DURATION, RANGE_T), highest=6)
def response_wanders() -> None:
    """Gains and axes of the sensor, or how it is turned, wander with time.

    The response of a sensor wanders smoothly: its gains, its axes or how it is turned.
    """


@correction(Turned, Wanders, lowest=0, highest=8)
def turns_wander() -> None:
    """The sensor turns with time.

    A sensor is turned, by an angle that wanders: it creeps in its clamp. Degree 0 is a turn that stays.
    """


def _turns_rad(circumstances: Circumstances, sensor: str) -> Float[Tensor, "reading 3"]:
    """Rotation vectors that the mover of a sensor reports; zero where none carries it."""
    rig, observations = circumstances.rig, circumstances.observations
    name = rig.sensors[circumstances.sensor_number(sensor)].carried_by
    if name is None:
        return observations.current_A.new_zeros(len(observations), 3)
    return vector_from_rotation(base_from_motion(rig.mover(name), observations.motion[name]).rotation)


def _axis_of_turns(circumstances: Circumstances, place: str) -> Starts:
    """The axis about which the mover turned, a unit vector in its base frame."""
    axis = torch.linalg.svd(_turns_rad(circumstances, place), full_matrices=False).Vh[0]
    axis = axis * torch.sign(axis[axis.abs().argmax()])
    return (dict(zip(AXIS, (round(c, AXIS_DIGITS) + 0.0 for c in axis.tolist()), strict=True)),)


def _has_turned(circumstances: Circumstances, place: str) -> bool:
    """Whether the mover of the sensor turned, and about one axis only."""
    turns_rad = _turns_rad(circumstances, place)
    size_rad = torch.linalg.svdvals(turns_rad)
    span_rad = turns_rad.max(0).values - turns_rad.min(0).values
    return float(span_rad.max()) > LEAST_ANGLE_RAD and float(size_rad[1]) < OFF_AXIS * float(size_rad[0])


@correction(
    Turned,
    Periodic,
    highest=8,
    shapes=box(AXIS, "", "1", 1.0, is_fixed=True),
    starts=_axis_of_turns,
    concerns=_has_turned,
    counts=("different angles", lambda now, place: (_turns_rad(now, place) / SAME_ANGLE_RAD).round()),
)
def turns_by_angle(theta: Theta, circumstances: Circumstances, sensor: str) -> Tensor:
    """How the sensor is turned depends on the angle of its rotary stage.

    A sensor is turned by an error that depends on the angle of the stage that carries it, as cosines and sines of its multiples.

    The bearing wobbles, or gravity bends the mount another way at each angle.
    """
    return (_turns_rad(circumstances, sensor) @ constants(theta, AXIS))[:, None] / (2.0 * math.pi)


@correction(Zero, Wanders)
def zero_wanders() -> None:
    """What the sensor shows in no field wanders with time.

    The zero of a sensor wanders smoothly.
    """


@correction(Zero, Swings)
def zero_swings() -> None:
    """What the sensor shows in no field swings with a period.

    The zero of a sensor swings, as of interference in its cable.
    """


@correction(Zero, Steps, single="offset_step")
def zero_steps() -> None:
    """What the sensor shows in no field jumps.

    What a sensor shows in no field jumps.
    """


@correction(Response, Steps, unit="1", highest=2)
def response_steps() -> None:
    """Gains and axes of the sensor, or of iron beside it, jump.

    The response of a sensor jumps, or that of iron beside it, which answers much the same field: it was exchanged, turned or moved.
    """


@correction(
    Zero,
    Table,
    unit="1",
    components=("share",),  # of all axes
    highest=4,
    depends_on="the readings before",
    # Readings follow one another in time.
    concerns=lambda circumstances: not circumstances.is_moment,
    counts=("readings one after another", lambda now, place: now.is_of(place).nonzero()),
)
def field_remembered(
    field_sensor_T: Components, circumstances: Circumstances, sensor: str
) -> dict[int, Tensor]:
    """The sensor shows something of the fields that it read before.

    A sensor shows something of the fields that it read before, as of eddy currents, a slow filter, or a clock that runs apart.

    Degree 1 is a share of the change since its last reading, degree 2 the same growing with time, degrees 3 and 4 shares of the changes
    before.
    """
    # What was read before is what was recorded, and what was not counts as no change.
    history_T = circumstances.observations.history.field_sensor_T.to(field_sensor_T.dtype)
    if bool(torch.isnan(history_T).all()):
        return {}
    rows = [circumstances.row_before(sensor)]
    for _ in range(2):
        rows.append(rows[0][rows[-1]])
    before_T = [history_T[previous[circumstances.observations.row]] for previous in rows]
    newest_T = torch.where(torch.isnan(before_T[0]), field_sensor_T, before_T[0]) - field_sensor_T
    late = (circumstances.hours / circumstances.duration_h)[:, None]
    older_T = [(before_T[i] - before_T[i - 1]).nan_to_num() for i in (1, 2)]
    return {1: newest_T, 2: late * newest_T, 3: older_T[0], 4: older_T[1]}

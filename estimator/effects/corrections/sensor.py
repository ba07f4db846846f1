"""Corrections of a sensor in time: how it responds, how it is turned, its zero, and what it keeps of readings before."""

from __future__ import annotations

from jaxtyping import Float

from estimator.effects.base import Quantities, Starts, Theta, box
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import RANGE_T, Correction, Limit, limit_of_number
from estimator.effects.corrections.in_time import DURATION, Response, Steps, Swings, Waves, Zero
from estimator.effects.stages import Components, ReadingEffect
from estimator.frames import vector_from_rotation
from estimator.geometry.motion import base_from_motion
from estimator.tensors import Tensor, torch

SAME_ANGLE_RAD = 1e-3
LEAST_ANGLE_RAD = 0.1  # that a mover turns through
AXIS_DIGITS = 6
OFF_AXIS = 1e-3  # of the angles: a mover that turns about several axes is no rotary stage
AXIS = ("axis_x", "axis_y", "axis_z")


class ResponseWanders(Response, Waves):
    """The response of a sensor wanders smoothly: its gains, its axes or how it is turned."""

    name = "response_wanders"
    words = "gains and axes of the sensor, or how it is turned, wander with time"
    scales = (DURATION, RANGE_T)
    highest = 6


class TurnsWander(Waves, ReadingEffect):
    """A sensor is turned, by an angle that wanders: it creeps in its clamp. Degree 0 is a turn that stays."""

    name = "turns_wander"
    words = "the sensor turns with time"
    unit = "1"
    lowest = 0
    highest = 8

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read, to first order in the turn."""
        return shown_by_turned(field_sensor_T, self.value(circumstances.hours_for_instants, theta))


class TurnsByAngle(Correction, ReadingEffect):
    """A sensor is turned by an error that depends on the angle of the stage that carries it, as cosines and sines of its multiples.

    The bearing wobbles, or gravity bends the mount another way at each angle.
    """

    name = "turns_by_angle"
    words = "how the sensor is turned depends on the angle of its rotary stage"
    unit = "1"
    components = tuple(f"{axis}_{wave}" for axis in "xyz" for wave in ("cos", "sin"))
    highest = 8
    falloff = 1.0

    def shapes(self, extent: Extent) -> Quantities:
        """Unit vector along the axis of the stage, in its base frame."""
        return box(AXIS, "", "1", 1.0, is_fixed=True)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """The axis about which the mover turned."""
        axis = torch.linalg.svd(_turns_rad(circumstances, place), full_matrices=False).Vh[0]
        axis = axis * torch.sign(axis[axis.abs().argmax()])
        return (dict(zip(AXIS, (round(c, AXIS_DIGITS) + 0.0 for c in axis.tolist()), strict=True)),)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover of the sensor turned, and about one axis only."""
        turns_rad = _turns_rad(circumstances, place)
        size_rad = torch.linalg.svdvals(turns_rad)
        span_rad = turns_rad.max(0).values - turns_rad.min(0).values
        return float(span_rad.max()) > LEAST_ANGLE_RAD and float(size_rad[1]) < OFF_AXIS * float(size_rad[0])

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different angles of the stage determines."""
        turns_rad = _turns_rad(circumstances, place)
        angles = torch.unique((turns_rad / SAME_ANGLE_RAD).round(), dim=0)
        return limit_of_number(self, len(angles), "different angles")

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read, to first order in the turn."""
        axis = torch.stack([theta[key].flatten()[0] for key in AXIS])
        angle_rad = _turns_rad(circumstances, sensor) @ axis
        turn_rad = field_sensor_T.new_zeros(3)
        for degree, amplitude in self.amplitudes(theta).items():
            waves = torch.stack((torch.cos(degree * angle_rad), torch.sin(degree * angle_rad)), dim=-1)
            turn_rad = turn_rad + waves @ amplitude.unflatten(-1, (3, 2)).mT
        return shown_by_turned(field_sensor_T, turn_rad)


class ZeroWanders(Zero, Waves):
    """The zero of a sensor wanders smoothly."""

    name = "zero_wanders"
    words = "what the sensor shows in no field wanders with time"


class ZeroSwings(Zero, Swings):
    """The zero of a sensor swings, as of interference in its cable."""

    name = "zero_swings"
    words = "what the sensor shows in no field swings with a period"


class ZeroSteps(Zero, Steps):
    """What a sensor shows in no field jumps."""

    name = "zero_steps"
    single = "offset_step"
    words = "what the sensor shows in no field jumps"
    highest = 5


class ResponseSteps(Response, Steps):
    """The response of a sensor jumps, or that of iron beside it, which answers much the same field: it was exchanged, turned or moved."""

    name = "response_steps"
    words = "gains and axes of the sensor, or of iron beside it, jump"
    unit = "1"
    highest = 2


class FieldRemembered(Correction, ReadingEffect):
    """A sensor shows something of the fields that it read before, as of eddy currents, a slow filter, or a clock that runs apart.

    Degree 1 is a share of the change since its last reading, degree 2 the same growing with time, degrees 3 and 4 shares of the changes
    before.
    """

    name = "field_remembered"
    words = "the sensor shows something of the fields that it read before"
    unit = "1"
    components = ("share",)  # of all axes
    highest = 4
    depends_on = "the readings before"

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether readings follow one another in time."""
        return not circumstances.is_moment

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of the sensor's readings determines."""
        return limit_of_number(self, int(circumstances.is_of(place).sum()), "readings one after another")

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read; what was read before is what was recorded, and what was not counts as no change."""
        amplitudes = self.amplitudes(theta)
        history_T = circumstances.observations.history.field_sensor_T.to(field_sensor_T.dtype)
        if not amplitudes or bool(torch.isnan(history_T).all()):
            return field_sensor_T
        rows = [circumstances.row_before(sensor)]
        for _ in range(2):
            rows.append(rows[0][rows[-1]])
        row = circumstances.observations.row
        before_T = [history_T[previous[row]] for previous in rows]
        newest_T = torch.where(torch.isnan(before_T[0]), field_sensor_T, before_T[0]) - field_sensor_T
        late = (circumstances.hours / circumstances.duration_h)[:, None]
        older_T = [(before_T[i] - before_T[i - 1]).nan_to_num() for i in (1, 2)]
        by_degree = {1: newest_T, 2: late * newest_T, 3: older_T[0], 4: older_T[1]}
        for degree, amplitude in amplitudes.items():
            field_sensor_T = field_sensor_T + amplitude[..., None, :] * by_degree[degree]
        return field_sensor_T


def shown_by_turned(field_sensor_T: Components, turn_rad: Float[Tensor, "*#batch #reading 3"]) -> Components:
    """Components of a field along the axes of a sensor that is turned in its own frame, to first order in the turn."""
    field_sensor_T, turn_rad = torch.broadcast_tensors(field_sensor_T, turn_rad)
    turned_T: Tensor = field_sensor_T - torch.linalg.cross(turn_rad, field_sensor_T, dim=-1)
    return turned_T


def _turns_rad(circumstances: Circumstances, sensor: str) -> Float[Tensor, "reading 3"]:
    """Rotation vectors that the mover of a sensor reports; zero where none carries it."""
    rig, observations = circumstances.rig, circumstances.observations
    name = rig.sensors[circumstances.sensor_number(sensor)].carried_by
    if name is None:
        return observations.current_A.new_zeros(len(observations), 3)
    return vector_from_rotation(base_from_motion(rig.mover(name), observations.motion[name]).rotation)

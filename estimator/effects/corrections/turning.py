"""A correction of how a sensor sits on a stage that turns it: another way at each angle."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import ReadingEffect
from estimator.frames import vector_from_rotation
from estimator.geometry.motion import base_from_motion
from estimator.tensors import Tensor, torch

SAME_ANGLE_RAD = 1e-3
LEAST_ANGLE_RAD = 0.1  # that a mover turns through
AXIS_DIGITS = 6
OFF_AXIS = 1e-3  # of the angles: a mover that turns about several axes is no rotary stage


class TurnsByAngle(Correction, ReadingEffect):
    """A sensor is turned by an error that depends on the angle of the stage that carries it, as cosines and sines of its multiples.

    The bearing wobbles, or gravity bends the mount another way at each angle.
    """

    name: ClassVar[str] = "turns_by_angle"
    words: ClassVar[str] = "how the sensor is turned depends on the angle of its rotary stage"
    unit: ClassVar[str] = "1"
    highest: ClassVar[int] = 8
    falloff: ClassVar[float] = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """Turn about which axis of the sensor, and which wave."""
        return tuple(f"{axis}_{wave}" for axis in "xyz" for wave in ("cos", "sin"))

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Unit vector along the axis of the stage, in its base frame."""
        return tuple(shape(f"axis_{axis}", "1", -1.0, 1.0, is_fixed=True) for axis in "xyz")

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The axis about which the mover turned."""
        turns_rad = _turns_rad(circumstances, place)
        axis = torch.linalg.svd(turns_rad, full_matrices=False).Vh[0]
        axis = axis * torch.sign(axis[axis.abs().argmax()])
        return (
            {
                f"axis_{name}": round(c, AXIS_DIGITS) + 0.0
                for name, c in zip("xyz", axis.tolist(), strict=True)
            },
        )

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
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read, to first order in the turn."""
        axis = torch.stack([theta[f"axis_{name}"].flatten()[0] for name in "xyz"])
        angle_rad = _turns_rad(circumstances, sensor) @ axis
        turn_rad = field_sensor_T.new_zeros(3)
        for degree, amplitude in self.amplitudes(theta).items():
            waves = torch.stack((torch.cos(degree * angle_rad), torch.sin(degree * angle_rad)), dim=-1)
            turn_rad = turn_rad + waves @ amplitude.unflatten(-1, (3, 2)).mT
        return shown_by_turned(field_sensor_T, turn_rad)


def shown_by_turned(
    field_sensor_T: Float[Tensor, "*#batch reading 3"], turn_rad: Float[Tensor, "*#batch #reading 3"]
) -> Float[Tensor, "*batch reading 3"]:
    """Components of a field along the axes of a sensor that is turned in its own frame, to first order in the turn."""
    field_sensor_T, turn_rad = torch.broadcast_tensors(field_sensor_T, turn_rad)
    turned_T: Tensor = field_sensor_T - torch.linalg.cross(turn_rad, field_sensor_T, dim=-1)
    return turned_T


def _turns_rad(circumstances: Circumstances, sensor: str) -> Float[Tensor, "reading 3"]:
    """Rotation vectors that the mover of a sensor reports; zero where none carries it."""
    rig, observations = circumstances.rig, circumstances.observations
    name = next(s.carried_by for s in rig.sensors if s.name == sensor)
    if name is None:
        return observations.current_A.new_zeros(len(observations), 3)
    return vector_from_rotation(base_from_motion(rig.mover(name), observations.motion[name]).rotation)

"""A mistake of the record: fields that software has turned into the axes of a base or of the room, though the file says the sensor's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, switch
from estimator.effects.causes.record import SMALLEST_TURN_RAD
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import ReadingEffect
from estimator.geometry.motion import base_from_motion, pose_of, world_from_body
from estimator.readings.observations import Observations
from estimator.rig.rig import MotionKind, Rig
from estimator.tensors import Tensor, torch

OWN, OF_BASE, OF_ROOM = range(3)  # axes in which fields are recorded


class FieldFrame(ReadingEffect):
    """The record holds fields in the axes of the mover's base or of the room: software has turned what the sensor said by its pose."""

    name: ClassVar[str] = "field_frame"
    words: ClassVar[str] = (
        "fields are recorded in the axes of the base or of the room, not in the sensor's own"
    )
    source: ClassVar[str] = (
        "software of arms and trackers that turns readings into the axes of its base or of the room"
    )
    is_record_mistake: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Axes of the record: 0 the sensor's, 1 those of the base of the mover that carries it, 2 those of the room."""
        return (switch("axes", float(OWN), float(OF_ROOM), float(OWN)),)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Sensors that a mover carries."""
        return tuple(sensor.name for sensor in rig.sensors if sensor.carried_by is not None)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Axes of base and room, once where they are the same."""
        _, of_base, of_room = _turns(circumstances.rig, circumstances.observations.history, place)
        same = bool((of_base - of_room).abs().max() < 1e-9)
        return tuple({"axes": float(axes)} for axes in ((OF_ROOM,) if same else (OF_BASE, OF_ROOM)))

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor turned: without, the sensor is mounted otherwise, or its axes are called otherwise."""
        _, _, of_room = _turns(circumstances.rig, circumstances.observations.history, place)
        since_first = of_room[:1].mT @ of_room
        cosine = 0.5 * (since_first.diagonal(dim1=-2, dim2=-1).sum(-1) - 1.0)
        return bool(torch.acos(cosine.clamp(-1.0, 1.0)).max() > SMALLEST_TURN_RAD)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are recorded."""
        each = torch.stack(_turns(circumstances.rig, circumstances.observations, sensor)).to(field_sensor_T)
        return (each[theta["axes"].round().long()] @ field_sensor_T[..., None])[..., 0]

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """The axes must be one of those that are known."""
        return None if values["axes"] in range(OF_ROOM + 1) else ("axes", f"must be 0, 1 or {OF_ROOM}")


def _turns(
    rig: Rig, observations: Observations, place: str
) -> tuple[Float[Tensor, "reading 3 3"], Float[Tensor, "reading 3 3"], Float[Tensor, "reading 3 3"]]:
    """Rotations from the sensor's axes into its own, those of the base and those of the room, as the rig file describes the set-up.

    A mover that reports displacements has no base; there the room counts twice.
    """
    sensor = next(each for each in rig.sensors if each.name == place)
    values = {name: observations.current_A.new_tensor(v) for name, v in rig.nominal_values().items()}
    flange = {m.name: base_from_motion(m, observations.motion[m.name]) for m in rig.movers}
    of_room = world_from_body(rig, sensor, "sensor", flange, values).rotation.expand(len(observations), 3, 3)
    own = torch.eye(3, dtype=of_room.dtype, device=of_room.device).expand_as(of_room)
    mover = rig.mover(sensor.carried_by or rig.movers[0].name)
    if mover.motion is MotionKind.DISPLACEMENT:
        return own, of_room, of_room
    return own, pose_of(f"{mover.name}.world_from_base", values).rotation.mT @ of_room, of_room

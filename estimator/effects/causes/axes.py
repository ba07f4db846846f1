"""Mistakes of the record: axes of a sensor that are not what they are called, and fields in the axes of a base or of the room.

Each is there or not, and makes the readings absurd unless undone.
"""

from __future__ import annotations

from jaxtyping import Float

from estimator.effects import axis_orders
from estimator.effects.base import Starts, Theta, switch, whole
from estimator.effects.causes.pose_record import SMALLEST_TURN_RAD
from estimator.effects.circumstances import Circumstances
from estimator.effects.during import during, from_instants
from estimator.effects.stages import Components, ReadingEffect
from estimator.rig.bodies import MotionKind
from estimator.tensors import Tensor, torch

OWN, OF_BASE, OF_ROOM = range(3)  # axes in which fields are recorded
KNOWN = whole(f"must be 0, 1 or {OF_ROOM}", OWN, OF_ROOM)
# The reversal of all axes is `current_sign`.
SWAPPED = tuple(order for order in axis_orders.ORDERS[1:] if order != axis_orders.REVERSED)


# Quantities: which component, 1 to 3, each axis reads, negative where it is reversed.
@ReadingEffect.cause(
    quantities=axis_orders.QUANTITIES,
    starts=SWAPPED,
    broken_rule=axis_orders.reads_one_twice,
    meaning=axis_orders.meaning,
    is_record_mistake=True,
)
def axes_swapped(field_sensor_T: Components, theta: Theta) -> Components:
    """The sensor's axes are in another order or direction.

    The sensor's axes are named or wired in another order or direction.

    Source: 46 signed permutations; the reversal of all is current_sign.
    """
    return (axis_orders.recorded_from_true(theta) @ field_sensor_T[..., None])[..., 0]


@during(
    axes_swapped,
    starts=lambda circumstances: from_instants((*SWAPPED, axis_orders.REVERSED), circumstances),
)
def axes_swapped_since() -> None:
    """From one instant on the sensor's axes are in another order or direction.

    From one instant on the sensor's axes are in another order or direction: it was taken out and put back turned over.

    Source: 47 signed permutations.
    """


def _turns(
    circumstances: Circumstances, place: str
) -> tuple[Float[Tensor, "reading 3 3"], Float[Tensor, "reading 3 3"], Float[Tensor, "reading 3 3"]]:
    """Rotations from the sensor's axes into its own, those of the base and those of the room, as the rig file describes the set-up.

    A mover that reports displacements has no base; there the room counts twice.
    """
    rig = circumstances.rig
    sensor = rig.sensors[circumstances.sensor_number(place)]
    of_room = circumstances.world_from(sensor).rotation.expand(len(circumstances), 3, 3)
    own = torch.eye(3, dtype=of_room.dtype, device=of_room.device).expand_as(of_room)
    mover = rig.mover(sensor.carried_by or rig.movers[0].name)
    if mover.motion is MotionKind.DISPLACEMENT:
        return own, of_room, of_room
    return own, circumstances.world_from_base(mover.name).rotation.mT @ of_room, of_room


def _axes_of_base_and_room(circumstances: Circumstances, place: str) -> Starts:
    """Axes of base and room, once where they are the same."""
    _, of_base, of_room = _turns(circumstances.of_history, place)
    same = bool((of_base - of_room).abs().max() < 1e-9)
    return tuple({"axes": float(axes)} for axes in ((OF_ROOM,) if same else (OF_BASE, OF_ROOM)))


def _has_turned(circumstances: Circumstances, place: str) -> bool:
    """Whether the sensor turned: without, the sensor is mounted otherwise, or its axes are called otherwise."""
    _, _, of_room = _turns(circumstances.of_history, place)
    since_first = of_room[:1].mT @ of_room
    cosine = 0.5 * (since_first.diagonal(dim1=-2, dim2=-1).sum(-1) - 1.0)
    return bool(torch.acos(cosine.clamp(-1.0, 1.0)).max() > SMALLEST_TURN_RAD)


# Quantities: axes of the record: 0 the sensor's, 1 those of the base of the mover that carries it, 2 those of the room.
@ReadingEffect.cause(
    quantities=(switch("axes", float(OWN), float(OF_ROOM), float(OWN), KNOWN),),
    places=lambda rig: tuple(sensor.name for sensor in rig.sensors if sensor.carried_by is not None),
    starts=_axes_of_base_and_room,
    concerns=_has_turned,
    is_record_mistake=True,
)
def field_frame(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """Fields are recorded in the axes of the base or of the room, not in the sensor's own.

    The record holds fields in the axes of the mover's base or of the room: software has turned what the sensor said by its pose.

    Source: software of arms and trackers that turns readings into the axes of its base or of the room.
    """
    each = torch.stack(_turns(circumstances, sensor)).to(field_sensor_T)
    return (each[theta["axes"].round().long()] @ field_sensor_T[..., None])[..., 0]

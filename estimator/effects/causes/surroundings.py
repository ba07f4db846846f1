"""Fields of the room that are there without current."""

from __future__ import annotations

import math

from estimator.effects.base import Quantities, Theta, shape, triple, vector
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.during import during, spell
from estimator.effects.stages import Components, Field, Points, RoomEffect
from estimator.tensors import torch

MOST_FREQUENCIES = 320  # as of corrections that swing in time
# Slopes of a field, in the order of its numbers; zz is what leaves no divergence.
SLOPES = ("xx", "yy", "xy", "xz", "yz")


@RoomEffect.cause(
    "steady_T", quantities=triple("xyz", "_T", "T", 50e-6), is_background=True, is_everywhere=True
)
def background_field(points_m: Points, theta: Theta) -> Field:
    """A constant field of the room, such as the Earth's, adds to that of the coils.

    A uniform field of the room, such as the Earth's.

    Source: the Earth's field, 25 to 65 uT (IGRF-13).
    """
    field = vector(theta, "xyz", "_T")
    return field.expand(*field.shape[:-2], points_m.shape[-2], 3)


# Quantities: change of the first component along the second axis; the field is that beyond the one at the origin.
@RoomEffect.cause("steady_T", quantities=triple(SLOPES, "_T_per_m", "T/m", 200e-6), is_background=True)
def background_gradient(points_m: Points, theta: Theta) -> Field:
    """The constant field of the room differs from place to place.

    The field of the room is not the same everywhere: it changes steadily across the room, as far from a magnet or from steel.

    Where no current flows its divergence and curl vanish, so the matrix of its slopes is symmetric and has no trace: five numbers.

    Source: steel benches, cupboards and magnets some metres off: 10 to 500 uT/m.
    """
    xx, yy, xy, xz, yz = (theta[f"{key}_T_per_m"] for key in SLOPES)
    rows = ((xx, xy, xz), (xy, yy, yz), (xz, yz, -xx - yy))
    return points_m @ torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


# Quantities: change per hour from the beginning of the session on.
@RoomEffect.cause(
    "drifting_T", quantities=lambda extent: triple("xyz", "_T_per_h", "T/h", 50e-6 / extent.duration_h)
)
def background_drift(theta: Theta, circumstances: Circumstances) -> Components:
    """The field of the room drifts.

    The field of the room changes steadily.

    Source: lifts, trams and magnets next door: some 10 uT within a session.
    """
    return vector(theta, "xyz", "_T_per_h") * circumstances.hours[:, None]


@during(background_field)
def background_step() -> None:
    """From one instant on the field of the room is different.

    From one instant on the field of the room is different, by the same everywhere.

    Source: a steel door or a chair that was moved, a magnet that was put down: 1 to 50 uT.
    """


@spell(background_step)
def background_spell() -> None:
    """For a while the field of the room is different.

    For a while the field of the room is different, by the same everywhere.

    Source: a door, a lift or a trolley that came and went, another coil that was on: 1 to 50 uT.
    """


def _swing(extent: Extent) -> Quantities:
    """Cosine and sine part of each component, from the beginning of the session on, and the frequency."""
    spacing, n = extent.frequencies_per_h(MOST_FREQUENCIES)
    parts = [f"{part}_{axis}" for part in ("cos", "sin") for axis in "xyz"]
    frequency = shape("frequency_per_h", "1/h", 0.5 * spacing, (n + 0.5) * spacing)
    return (*triple(parts, "_T", "T", 20e-6), frequency)


@RoomEffect.cause(
    "drifting_T", quantities=_swing, starts=lambda circumstances: circumstances.frequencies(MOST_FREQUENCIES)
)
def periodic_interference(theta: Theta, circumstances: Circumstances) -> Components | None:
    """The field of the room swings periodically.

    The field of the room swings with a period of its own, everywhere alike.

    On a regular clock, a swing faster than half a cycle between readings looks like a slower one; frequencies stop there. They also stop at
    160 cycles in a session (320 starts): farther apart than half a cycle in a session, starts would miss swings between them.

    Source: mains and machines nearby, 1 to 50 uT; their beat with the clock of the readings.
    """
    if circumstances.is_moment:
        return None  # it has no phase
    angle = 2.0 * math.pi * theta["frequency_per_h"][..., None] * circumstances.hours
    cos_T, sin_T = (vector(theta, [f"{part}_{axis}" for axis in "xyz"], "_T") for part in ("cos", "sin"))
    return cos_T * torch.cos(angle)[..., None] + sin_T * torch.sin(angle)[..., None]

"""Mistakes in the record of poses: rotations in another convention, lengths in another unit, rows that belong to other readings.

Each is there or not, and makes the readings absurd unless undone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import permutations
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, switch
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import MotionEffect, RecordEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.rig.rig import MotionKind, Rig
from estimator.tensors import Tensor, torch

# mm under m, m under mm, mm under cm, ..., inch under mm.
LENGTH_FACTORS = (1e3, 1e-3, 10.0, 0.1, 1.0 / 25.4, 25.4)
# Orders in which turns about fixed axes follow one another, the first one first.
ORDERS = tuple(permutations((0, 1, 2)))
REVERSED, IN_DEGREES = len(ORDERS) + 1, len(ORDERS) + 2
MOST_ROWS = 2  # that a logger runs late or early


class RotationConvention(MotionEffect):
    """The three columns of a rotation are no rotation vector: angles about three axes, the inverse rotation, or degrees."""

    name: ClassVar[str] = "rotation_convention"
    words: ClassVar[str] = "rotations are recorded in another convention than rotation vectors"
    source: ClassVar[str] = "angles about the axes in each of 6 orders, the inverse rotation, degrees"
    is_record_mistake: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """0: a rotation vector; 1 to 6: angles about fixed axes, in the order xyz, xzy, yxz, yzx, zxy, zyx; 7: the inverse; 8: degrees."""
        return (switch("convention", 0.0, float(IN_DEGREES), 0.0),)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Movers that report rotations."""
        with_rotations = (MotionKind.DISPLACEMENT, MotionKind.POSE)
        return tuple(mover.name for mover in rig.movers if mover.motion in with_rotations)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """All conventions but that of the file."""
        return tuple({"convention": float(i)} for i in range(1, IN_DEGREES + 1))

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover turned."""
        return bool(circumstances.observations.history.motion[place][:, 3:].any())

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """The three columns as they were recorded."""
        return circumstances.observations.motion[mover][:, 3:]

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        about = [
            rotation_from_vector(
                columns[:, i : i + 1] * torch.eye(3, dtype=columns.dtype, device=columns.device)[i]
            )
            for i in range(3)
        ]
        as_angles = [about[third] @ about[second] @ about[first] for first, second, third in ORDERS]
        rotation = rotation_from_vector(columns)
        each = torch.stack((rotation, *as_angles, rotation.mT, rotation_from_vector(torch.deg2rad(columns))))
        return Transform(each[theta["convention"].round().long()], pose.translation_m)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """The convention must be one of those that are known."""
        is_known = values["convention"] in range(IN_DEGREES + 1)
        return None if is_known else ("convention", f"must be a whole number from 0 to {IN_DEGREES}")


class PositionUnit(MotionEffect):
    """One axis of a mover, or all of them, was recorded in another unit than the file says."""

    name: ClassVar[str] = "position_unit"
    words: ClassVar[str] = "positions are recorded in another unit than stated, along one axis or all"
    source: ClassVar[str] = "powers of ten between m, cm and mm; inches"
    is_record_mistake: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Recorded over true positions of each axis."""
        return tuple(switch(f"{axis}_factor", 0.0, 1e9, 1.0) for axis in "xyz")

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Movers that report positions."""
        return tuple(mover.name for mover in rig.movers if mover.table is None)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The usual slips, on each axis along which the mover went, and on all."""
        moved = self._moved(circumstances, place) or ["x", "y", "z"]
        groups = [(axis,) for axis in moved] + ([tuple("xyz")] if len(moved) > 1 else [])
        return tuple(
            {f"{axis}_factor": factor if axis in group else 1.0 for axis in "xyz"}
            for factor in LENGTH_FACTORS
            for group in groups
        )

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover moved."""
        return bool(self._moved(circumstances, place))

    @staticmethod
    def _moved(circumstances: Circumstances, mover: str) -> list[str]:
        """Axes along which the mover moved."""
        here_m = circumstances.observations.history.motion[mover][:, :3]
        return [axis for i, axis in enumerate("xyz") if bool((here_m[:, i] != here_m[0, i]).any())]

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        factor = torch.stack([theta[f"{axis}_factor"] for axis in "xyz"], dim=-1)[..., None, :]
        return Transform(pose.rotation, pose.translation_m / factor)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Factors are positive."""
        return next(((key, "must be > 0") for key, value in values.items() if not value > 0.0), None)


class RowsShifted(RecordEffect):
    """Fields were written down some rows late or early: each belongs to the pose and the currents of another row."""

    name: ClassVar[str] = "rows_shifted"
    words: ClassVar[str] = "fields stand some rows beside the poses and currents that they belong to"
    source: ClassVar[str] = f"buffers of loggers, {MOST_ROWS} readings at most"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Rows by which fields come late; negative where they come early."""
        return (switch("rows", -float(MOST_ROWS), float(MOST_ROWS), 0.0),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Late and early, where there is a row beside."""
        most = min(MOST_ROWS, len(circumstances.observations.history) - 1)
        return tuple({"rows": float(sign * n)} for n in range(1, most + 1) for sign in (1, -1))

    def rows_late(self, values: Mapping[str, float]) -> int:
        """Number of rows by which fields come late."""
        return round(values["rows"])

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Rows are whole."""
        rows = values["rows"]
        is_row = math.isfinite(rows) and rows.is_integer() and abs(rows) <= MOST_ROWS
        return None if is_row else ("rows", f"must be a whole number from {-MOST_ROWS} to {MOST_ROWS}")

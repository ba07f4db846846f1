"""A request for an export: a calibration, and for formats that hold a field or frames the points, currents and poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from estimator.errors import InvalidInput, check_known
from estimator.export.calibrated import Calibrated, Motion
from estimator.export.labels import plain_words
from estimator.export.magnet import Magnet
from estimator.tensors import Tensor, torch

BLOCK = 10_000  # points evaluated at once
PROPORTIONAL = 1e-9  # of the field: what the sum of all coils may be off


@dataclass(frozen=True)
class Grid:
    """Points on a grid along the axes of the world frame.

    Attributes:
        x_m, y_m, z_m: Coordinates along each axis, ascending.
    """

    x_m: Float[np.ndarray, " x"]
    y_m: Float[np.ndarray, " y"]
    z_m: Float[np.ndarray, " z"]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of points along each axis."""
        return len(self.x_m), len(self.y_m), len(self.z_m)

    @property
    def points_m(self) -> Float[Tensor, "point 3"]:
        """All points; z runs fastest."""
        axes = np.meshgrid(self.x_m, self.y_m, self.z_m, indexing="ij")
        return torch.from_numpy(np.stack(axes, axis=-1).reshape(-1, 3))


@dataclass(frozen=True)
class Request:
    """One export.

    Attributes:
        to: Name of the format.
        magnet: What is exported.
        path: File to write.
        grid: Points, for formats that hold a field.
        currents_A: Current of each coil by name, for formats that hold a field; coils that are not named are off.
        motion: Six numbers of each mover, for formats in which nothing moves; zeros where a mover is not named.
    """

    to: str
    magnet: Magnet
    path: Path
    grid: Grid | None = None
    currents_A: Mapping[str, float] = field(default_factory=dict)
    motion: Motion = field(default_factory=dict)

    def __post_init__(self) -> None:
        movers = dict.fromkeys(mover.name for part in self.magnet.parts for mover in part.rig.movers)
        check_known("motion must name movers of the rig", self.motion, movers)

    @property
    def calibrated(self) -> Calibrated:
        """The calibration, for formats that hold one.

        Raises:
            InvalidInput: There are several.
        """
        if self.magnet.only is None:
            raise InvalidInput(
                f"export to {self.to} must have one calibration; received {len(self.magnet.parts)}"
            )
        return self.magnet.only

    def points(self) -> Grid:
        """Grid of points that the export was asked for.

        Raises:
            InvalidInput: There is none.
        """
        if self.grid is None:
            raise InvalidInput(
                f"export to {self.to} must have a grid, such as --grid x_mm=-50:50:11; received none"
            )
        return self.grid

    @property
    def words(self) -> str:
        """Magnet, currents and poses in one line."""
        currents = ", ".join(f"{name} {value:g} A" for name, value in self.currents_A.items())
        poses = ", ".join(
            f"{name} {[round(x, 6) for x in row.tolist()]}" for name, row in self.motion.items()
        )
        return f"calibrated magnet {plain_words(self.magnet.name)} at {currents}; movers at {poses or 'rest'}"

    def on_grid(
        self,
    ) -> tuple[Grid, Float[np.ndarray, "x y z 3"], Float[np.ndarray, "x y z 3 3"]]:
        """Grid, field and gradient dB_i / dx_j at its points, as `field_and_gradient`."""
        grid = self.points()
        blocks = [self.field_and_gradient(block_m) for block_m in grid.points_m.split(BLOCK)]
        field_T, gradient = (torch.cat(parts).numpy() for parts in zip(*blocks, strict=True))
        return grid, field_T.reshape(*grid.shape, 3), gradient.reshape(*grid.shape, 3, 3)

    def field_and_gradient(
        self, points_m: Float[Tensor, "point 3"]
    ) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3 3"]]:
        """Field and gradient at points, at the currents and poses of the request.

        Raises:
            InvalidInput: No currents, or a coil or mover that is not there.
        """
        if not self.currents_A:
            raise InvalidInput(
                f"export to {self.to} must have currents, such as --current coil1=1; received none"
            )
        check_known("currents must name coils of the magnet", self.currents_A, self.magnet.coils)
        field_T, gradient = points_m.new_zeros(len(points_m), 3), points_m.new_zeros(len(points_m), 3, 3)
        for part in self.magnet.parts:
            names = [coil.name for coil in part.rig.coils]
            currents_A = {name: value for name, value in self.currents_A.items() if name in names}
            motion = motion_of(part, self.motion)
            field_T = field_T + part.field(points_m, currents_A, motion)
            gradient = gradient + part.gradient(points_m, currents_A, motion)
        return field_T, gradient

    def per_ampere_on(self, points_m: Float[Tensor, "point 3"]) -> Float[Tensor, "coil point 3"]:
        """Field per ampere of every coil at points in the world frame, at the poses of the request, in T/A.

        Raises:
            InvalidInput: A point inside a winding, or a field that is not proportional to the currents.
        """
        fields: dict[str, Tensor] = {}
        for part in self.magnet.parts:
            room, best = part.room(points_m, motion_of(part, self.motion)), part.best_values()
            n = len(part.rig.coils)
            probe_A = torch.arange(2.0, n + 2.0, dtype=torch.float64)
            each_A, off_A = torch.eye(n, dtype=torch.float64), torch.zeros(1, n, dtype=torch.float64)
            field_T = room.field_T(best, torch.cat((each_A, probe_A[None], off_A)))
            if n_inside := int(room.is_inside.sum()):
                raise InvalidInput(
                    f"grid of {self.to} must lie outside the windings; {n_inside} of {len(points_m)} points do not"
                )
            per_ampere, together_T, off_T = field_T[:n], field_T[n], field_T[n + 1]
            missed_T = together_T - torch.einsum("c,cpx->px", probe_A, per_ampere)
            error_T = missed_T.norm(dim=-1) + off_T.norm(dim=-1)
            if (error_T > PROPORTIONAL * together_T.norm(dim=-1)).any():
                raise InvalidInput(
                    f"export to {self.to} must have a field proportional to the currents; that of rig {part.rig.name!r} is not, "
                    "or is there without current, which --coils-alone leaves out"
                )
            fields |= dict(zip((coil.name for coil in part.rig.coils), per_ampere, strict=True))
        return torch.stack([fields[name] for name in self.magnet.coils])


def motion_of(part: Calibrated, motion: Motion) -> Motion:
    """The movers of a part; a name that it does not know belongs to another one."""
    known = {mover.name for mover in part.rig.movers}
    return {name: row for name, row in motion.items() if name in known}

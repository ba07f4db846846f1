"""What somebody wants exported: a calibration, and for formats that hold a field or frames the points, currents and poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.export.calibrated import Calibrated, Motion


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
        calibrated: What is exported.
        path: File to write.
        grid: Points, for formats that hold a field.
        currents_A: Current of each coil by name, for formats that hold a field; coils that are not named are off.
        motion: Six numbers of each mover, for formats in which nothing moves; zeros where a mover is not named.
    """

    calibrated: Calibrated
    path: Path
    grid: Grid | None = None
    currents_A: Mapping[str, float] = field(default_factory=dict)
    motion: Motion = field(default_factory=dict)

    def points(self, to: str) -> Grid:
        """The grid.

        Raises:
            InvalidInput: There is none.
        """
        if self.grid is None:
            raise InvalidInput(
                f"export to {to} must have a grid, such as --grid x_mm=-50:50:11; received none"
            )
        return self.grid

"""A field map on a grid as a smooth field: cubic splines by SciPy, evaluated by torch so that a fit has derivatives in the position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from estimator.errors import InvalidInput
from estimator.tensors import Tensor, torch

DEGREE = 3
FEWEST_POINTS = 2 * DEGREE + 1  # along an axis: every second one still makes a cubic spline


@dataclass(frozen=True)
class GridMap:
    """Field per ampere on a grid along the axes of a coil's frame.

    Attributes:
        axes_m: Coordinates along x, y and z, ascending.
        values: Bx, By, Bz in T/A at every point.
        knots_m: Of the spline along each axis.
        coefficients: Of the products of the splines.
    """

    axes_m: tuple[Float[np.ndarray, " x"], Float[np.ndarray, " y"], Float[np.ndarray, " z"]]
    values: Float[np.ndarray, "x y z 3"]
    knots_m: tuple[Tensor, ...]
    coefficients: Float[Tensor, "x y z 3"]

    @classmethod
    def of(
        cls, axes_m: tuple[np.ndarray, np.ndarray, np.ndarray], values: Float[np.ndarray, "x y z 3"]
    ) -> GridMap:
        """The map through values on a grid.

        Raises:
            InvalidInput: Fewer than seven points along an axis.
        """
        for name, axis_m in zip("xyz", axes_m, strict=True):
            if len(axis_m) < FEWEST_POINTS:
                raise InvalidInput(
                    f"field map must have at least {FEWEST_POINTS} points along {name}; received {len(axis_m)}"
                )
        return cls._through(axes_m, values)

    @classmethod
    def _through(
        cls, axes_m: tuple[np.ndarray, np.ndarray, np.ndarray], values: Float[np.ndarray, "x y z 3"]
    ) -> GridMap:
        from scipy.interpolate import (
            make_interp_spline,  # half a second, which only field maps on a grid need
        )

        knots_m, coefficients = [], values
        for i, axis_m in enumerate(axes_m):
            spline = make_interp_spline(axis_m, coefficients, k=DEGREE, axis=i)
            knots_m.append(torch.from_numpy(spline.t))
            coefficients = np.moveaxis(spline.c, 0, i)
        return cls(axes_m, values, tuple(knots_m), torch.from_numpy(np.ascontiguousarray(coefficients)))

    def coarser(self) -> GridMap:
        """The map by every second point along each axis, ends included: what it differs by bounds the error of interpolation."""
        rows = [np.unique([*range(0, len(axis_m), 2), len(axis_m) - 1]) for axis_m in self.axes_m]
        axes_m = tuple(axis_m[keep] for axis_m, keep in zip(self.axes_m, rows, strict=True))
        return GridMap._through((axes_m[0], axes_m[1], axes_m[2]), self.values[np.ix_(*rows)])

    def holds(self, points_m: Float[Tensor, "point 3"]) -> Bool[Tensor, " point"]:
        """Whether points lie on the grid or between its points."""
        low, high = (points_m.new_tensor([axis_m[end] for axis_m in self.axes_m]) for end in (0, -1))
        return ((points_m >= low) & (points_m <= high)).all(-1)

    def field(self, points_m: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        """Field per ampere at points of the coil frame; beyond the grid the outermost polynomials go on.

        References: de Boor, A Practical Guide to Splines (2001), chapter IX, the recurrence of B-splines.
        """
        first, weights = zip(
            *(
                _b_splines(x_m, knots_m.to(x_m))
                for x_m, knots_m in zip(points_m.unbind(-1), self.knots_m, strict=True)
            ),
            strict=True,
        )
        steps = torch.arange(DEGREE + 1, device=points_m.device)
        i, j, k = (start[..., None] + steps for start in first)
        near = self.coefficients.to(points_m)[
            i[..., :, None, None], j[..., None, :, None], k[..., None, None, :]
        ]
        return torch.einsum("...i,...j,...k,...ijkc->...c", *weights, near)


def _b_splines(x_m: Float[Tensor, "*batch"], knots_m: Float[Tensor, " knot"]) -> tuple[Tensor, Tensor]:
    """Number of the first B-spline that is not zero at each point, and the four that are not."""
    span = torch.searchsorted(knots_m, x_m.detach().contiguous(), right=True) - 1
    span = span.clamp(DEGREE, len(knots_m) - DEGREE - 2)
    splines = [torch.ones_like(x_m)]
    for degree in range(1, DEGREE + 1):
        raised = [torch.zeros_like(x_m) for _ in range(degree + 1)]
        for i, spline in enumerate(splines):
            right, left = knots_m[span + i + 1], knots_m[span + i + 1 - degree]
            share = spline / (right - left)
            raised[i] = raised[i] + (right - x_m) * share
            raised[i + 1] = raised[i + 1] + (x_m - left) * share
        splines = raised
    return span - DEGREE, torch.stack(splines, dim=-1)

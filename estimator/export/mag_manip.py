"""A vfield grid for mag_manip, the toolbox of ETH's Multi-Scale Robotics Lab: field per ampere of every coil on one grid, in YAML."""

from __future__ import annotations

import yaml

from estimator.errors import InvalidInput
from estimator.export.request import Grid, Request

LEAST_POINTS = 2  # along each axis, between which it interpolates


def vfield_yaml(request: Request) -> str:
    """The text of the file.

    Rows of `data` are Bx, By, Bz in T/A; z runs fastest, then y. Coils come in the order of the rig as `coil_0`, `coil_1`, ...
    mag_manip 3.0.0 reads a grid right if every axis has as many points.

    Raises:
        InvalidInput: No grid of two or more evenly spaced points, equally many along each axis, a point inside a winding, or a field
            that is not proportional to the currents.
    """
    grid = request.points()
    # mag_manip 3.0.0 steps by dim_y along y and by dim_x dim_y along x, where z runs fastest.
    if len(set(grid.shape)) > 1:
        raise InvalidInput(
            f"grid of mag_manip must have as many points along each axis; received {' x '.join(map(str, grid.shape))}"
        )
    spans = _spans(grid)
    per_ampere = request.per_ampere_on(grid.points_m)
    names = ", ".join(request.magnet.coils)
    vfields = {f"coil_{i}": {**spans, "data": field.tolist()} for i, field in enumerate(per_ampere)}
    header = (
        f"# Field per ampere of {names}, in T/A at points in m of the world frame; made by coilcal export.\n"
    )
    document = {"name": request.magnet.name, "vfields": vfields}
    return header + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=200)


def _spans(grid: Grid) -> dict[str, int | float]:
    """Size and ends of the grid, as mag_manip names them."""
    spans: dict[str, int | float] = {f"dim_{axis}": n for axis, n in zip("xyz", grid.shape, strict=True)}
    for axis, coordinates_m in zip("xyz", (grid.x_m, grid.y_m, grid.z_m), strict=True):
        steps_m = coordinates_m[1:] - coordinates_m[:-1]
        if len(coordinates_m) < LEAST_POINTS or abs(steps_m - steps_m[0]).max() > 1e-9 * abs(steps_m[0]):
            raise InvalidInput(
                f"grid of mag_manip must have {LEAST_POINTS} or more evenly spaced points along {axis}; received {len(coordinates_m)}"
            )
        spans |= {f"min_{axis}": float(coordinates_m[0]), f"max_{axis}": float(coordinates_m[-1])}
    return spans

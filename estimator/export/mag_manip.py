"""A vfield grid for mag_manip, the toolbox of ETH's Multi-Scale Robotics Lab: field per ampere of every coil on one grid, in YAML."""

from __future__ import annotations

import yaml
from jaxtyping import Float

from estimator.errors import InvalidInput
from estimator.export.calibrated import Calibrated, Motion
from estimator.export.request import Grid, Request, motion_of
from estimator.tensors import Tensor, torch

LEAST_POINTS = 2  # along each axis, between which it interpolates
PROPORTIONAL = 1e-9  # of the field: what the sum of all coils may be off


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
    fields: dict[str, Tensor] = {}
    for part in request.magnet.parts:
        of_part = per_ampere_on(part, grid.points_m, motion_of(part, request.motion))
        fields |= dict(zip((coil.name for coil in part.rig.coils), of_part, strict=True))
    per_ampere = [fields[name] for name in request.magnet.coils]
    names = ", ".join(request.magnet.coils)
    vfields = {f"coil_{i}": {**spans, "data": field.tolist()} for i, field in enumerate(per_ampere)}
    header = (
        f"# Field per ampere of {names}, in T/A at points in m of the world frame; made by coilcal export.\n"
    )
    document = {"name": request.magnet.name, "vfields": vfields}
    return header + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=200)


def per_ampere_on(
    calibrated: Calibrated, points_m: Float[Tensor, "point 3"], motion: Motion, to: str = "mag_manip"
) -> Float[Tensor, "coil point 3"]:
    """Field per ampere of every coil of a calibration.

    Args:
        calibrated, points_m, motion: The calibration, points in the world frame, and poses of its movers.
        to: What is exported to, for the message.
    Raises:
        InvalidInput: A point inside a winding, or a field that is not proportional to the currents.
    """
    room, best = calibrated.room(points_m, motion), calibrated.best_values()
    n = len(calibrated.rig.coils)
    probe_A = torch.arange(2.0, n + 2.0, dtype=torch.float64)
    currents_A = torch.cat(
        (torch.eye(n, dtype=torch.float64), probe_A[None], torch.zeros(1, n, dtype=torch.float64))
    )
    field_T = room.field_T(best, currents_A)
    if room.is_inside.any():
        raise InvalidInput(
            f"grid of {to} must lie outside the windings; {int(room.is_inside.sum())} of {len(points_m)} points do not"
        )
    per_ampere, together_T, off_T = field_T[:n], field_T[n], field_T[n + 1]
    error_T = (together_T - torch.einsum("c,cpx->px", probe_A, per_ampere)).norm(dim=-1) + off_T.norm(dim=-1)
    if (error_T > PROPORTIONAL * together_T.norm(dim=-1)).any():
        raise InvalidInput(
            f"export to {to} must have a field proportional to the currents; that of rig {calibrated.rig.name!r} is not, "
            "or is there without current"
        )
    return per_ampere


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

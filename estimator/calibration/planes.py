"""The calibrated field around each coil in the plane through its axis, with its uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt, zoom

from estimator.calibration.fitted import fitted, sensor_positions
from estimator.calibration.result import Calibration
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.model.room_field import RoomField, at_one_moment, some_at_a_time
from estimator.rig.bodies import AnyCoil

MOST_COILS = 3
PLANE_POINTS = 61
PLANE_DRAWS = 100


class CoilPlane(NamedTuple):
    """Field of one ampere in the plane y = 0 of a coil's frame.

    Attributes:
        coil: Its name.
        x_m, z_m: Coordinates, evenly spaced.
        field_T_per_A: Vectors in the coil's frame, by z and x.
        relative: Half-width of the 90 % interval of the size of the field, over the size.
        positions_m: Places of the sensor.
        winding: Of the coil; None where it is not known.
    """

    coil: str
    x_m: np.ndarray
    z_m: np.ndarray
    field_T_per_A: np.ndarray
    relative: np.ndarray
    positions_m: np.ndarray
    winding: Winding | None


def coil_planes(calibration: Calibration, n_points: int = PLANE_POINTS) -> Iterator[CoilPlane]:
    """The field of each coil that carried current, of the first few where there are many."""
    fit = fitted(calibration)
    for coil, positions_m, winding in islice(sensor_positions(calibration, fit), MOST_COILS):
        yield coil_plane(calibration, coil, positions_m, fit.best, winding, n_points)


def coil_plane(
    calibration: Calibration,
    coil: AnyCoil,
    positions_m: np.ndarray,
    best: Mapping[str, torch.Tensor],
    winding: Winding | None,
    n_points: int = PLANE_POINTS,
) -> CoilPlane:
    """The field around a coil, without that of the room, as far as its readings reach.

    The plane is at most twice as high as wide: beyond that the field is a dipole's and panels get thin.
    """
    alone = calibration.coils_alone()
    reach = 1.2 * np.nanmax(np.abs(positions_m[:, :2]))
    if winding is None:
        reach = max(reach, 1.2 * float(np.nanmax(np.abs(positions_m))))
        low, high = -reach, reach
    else:
        radius_m, length_m = float(winding.radius_m), float(winding.length_m)
        reach = max(reach, 1.2 * radius_m)
        low = min(-1.3 * length_m, max(1.1 * np.nanmin(positions_m[:, 2]), -0.5 * length_m - 2.0 * reach))
        high = max(0.5 * radius_m, min(1.1 * np.nanmax(positions_m[:, 2]), 2.0 * reach))
    x_m, z_m = np.linspace(-reach, reach, n_points), np.linspace(low, high, n_points)
    field = _field_per_A(alone, coil, best, _grid(x_m, z_m))
    # Half as fine, for it is smooth: draws of an effect that sums over all loops would take minutes.
    coarse_x_m, coarse_z_m = (np.linspace(at[0], at[-1], n_points // 2 + 1) for at in (x_m, z_m))
    coarse = _relative_half_width(alone, coil, best, _grid(coarse_x_m, coarse_z_m))
    coarse = coarse.reshape(len(coarse_z_m), -1)
    nearest = distance_transform_edt(~np.isfinite(coarse), return_distances=False, return_indices=True)
    half_width = zoom(coarse[tuple(nearest)], n_points / len(coarse), order=1)  # linear between its points
    half_width[~np.isfinite(field).all(-1).reshape(n_points, n_points)] = np.nan  # inside the winding
    return CoilPlane(
        coil.name, x_m, z_m, field.reshape(n_points, n_points, 3), half_width, positions_m, winding
    )


def _grid(x_m: np.ndarray, z_m: np.ndarray) -> torch.Tensor:
    """Points of the plane y = 0, row by row of z."""
    z, x = np.meshgrid(z_m, x_m, indexing="ij")
    return torch.from_numpy(np.stack((x, np.zeros_like(x), z), axis=-1).reshape(-1, 3))


def _field_per_A(
    calibration: Calibration, coil: AnyCoil, best: Mapping[str, torch.Tensor], points_m: torch.Tensor
) -> np.ndarray:
    """Field per ampere around the coil, in its frame."""
    world_from_coil, room, current_A = _around(calibration, coil, best, points_m)
    return world_from_coil.unrotate(room.field_T(best, current_A)).numpy()


def _relative_half_width(
    calibration: Calibration, coil: AnyCoil, best: Mapping[str, torch.Tensor], points_m: torch.Tensor
) -> np.ndarray:
    """Half-width of the 90 % interval of the magnitude of that field, relative to it."""
    _, room, current_A = _around(calibration, coil, best, points_m)
    strength = some_at_a_time(
        lambda values: room.field_T(values, current_A).norm(dim=-1),
        calibration.draw_values(PLANE_DRAWS),
        len(points_m),
        1,
    )
    ends = torch.tensor([0.05, 0.95], dtype=torch.float64)
    lower, upper = torch.quantile(torch.atleast_2d(strength), ends, dim=0)
    return (0.5 * (upper - lower) / room.field_T(best, current_A).norm(dim=-1)).numpy()


def _around(
    calibration: Calibration, coil: AnyCoil, best: Mapping[str, torch.Tensor], points_m: torch.Tensor
) -> tuple[Transform, RoomField, torch.Tensor]:
    """The frame of a coil, the field at points in it, and one ampere in that coil alone."""
    rig = calibration.rig
    world_from_coil = at_one_moment(rig).world_from_body(coil, "coil", torch.arange(1), best)
    current_A = torch.tensor([float(powered is coil) for powered in rig.coils], dtype=torch.float64)
    return world_from_coil, RoomField(rig, best, world_from_coil.apply(points_m)), current_A

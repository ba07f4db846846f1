"""A multipole electromagnet model (MPEM) for mag_manip, the toolbox of ETH's Multi-Scale Robotics Lab, in YAML.

Its sources are axially symmetric. The potential of a source at c with direction d is the sum over n of A_n r^n P_n(cos) with r the distance
from c and cos the cosine of the angle from d; the field is minus its gradient. 2 n + 1 directions in general position span all harmonics of
degree n, so sources in the middle of a box hold any field of currents that flow outside the ball about it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import yaml
from jaxtyping import Float

from estimator.errors import InvalidInput
from estimator.export.request import Grid, Request
from estimator.tensors import torch

DEGREES = range(2, 13, 2)  # tried in turn
ENOUGH = 1e-5  # error of the largest field at which no higher degree is tried; predictions sum their loops to a tenth of it
TOO_MUCH = 0.01  # above it nothing is written: the box reaches beyond the nearest winding
NODES = 7  # Gauss-Legendre points along each axis of the box, at which a field is fitted
N_CHECKS = 200  # other points in the box, at which the error is told
GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))

Points = Float[np.ndarray, "point 3"]


@dataclass(frozen=True)
class Box:
    """The workspace: where the fields are fitted, and outside of which they are not meant.

    Attributes:
        low_m, high_m: Its corners in the world frame.
    """

    low_m: Float[np.ndarray, " 3"]
    high_m: Float[np.ndarray, " 3"]

    @property
    def middle_m(self) -> Float[np.ndarray, " 3"]:
        """Middle of the box in the world frame, in m; the sources are there."""
        return np.asarray(0.5 * (self.low_m + self.high_m))

    @property
    def reach_m(self) -> float:
        """Distance of its corners from the middle."""
        return 0.5 * float(np.linalg.norm(self.high_m - self.low_m))

    def points_m(self, share: Points) -> Points:
        """Points by their place between the corners, each coordinate from -1 to 1."""
        return np.asarray(self.middle_m + 0.5 * (self.high_m - self.low_m) * share)


def mpem_yaml(request: Request) -> str:
    """The text of the file; coils come in the order of the rig as `Coil_0`, `Coil_1`, ...

    Raises:
        InvalidInput: No grid with two or more points along each axis, a point of its box inside a winding, a field that is not
            proportional to the currents, or a winding too near for multipoles.
    """
    box = _box(request.points())
    nodes = np.polynomial.legendre.leggauss(NODES)[0]
    fitted_at = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    corners = np.stack(np.meshgrid(*([-1.0, 1.0],) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    checked_at = np.concatenate((corners, np.random.default_rng(0).uniform(-1.0, 1.0, (N_CHECKS, 3))))
    points_m = torch.from_numpy(box.points_m(np.concatenate((fitted_at, checked_at))))
    per_ampere = request.per_ampere_on(points_m).movedim(0, -1).numpy()
    degree, coefficients, errors = _fit(box, points_m.numpy(), per_ampere, len(fitted_at))
    worst = int(np.argmax(errors))
    if errors[worst] > TOO_MUCH:
        raise InvalidInput(
            f"box of the grid must lie well away from the windings for multipoles; with degree {degree} the field of "
            f"{request.magnet.coils[worst]} is {100.0 * errors[worst]:.2g} % off"
        )
    directions = _directions(degree)
    sources = [f"Src_{number}" for number in range(len(directions))]
    document = {
        "System_Name": request.magnet.name,
        "Workspace_Dimensions": np.stack((box.low_m, box.high_m), axis=-1).tolist(),
        "Coil_List": [f"Coil_{number}" for number in range(len(errors))],
    }
    for number in range(len(errors)):
        document[f"Coil_{number}"] = {"Source_List": sources} | {
            source: {
                "A_Coeff": coefficients[k, :, number].tolist(),
                "B_Coeff": None,
                "Source_Position": box.middle_m.tolist(),
                "Source_Direction": directions[k].tolist(),
            }
            for k, source in enumerate(sources)
        }
    return _header(request, degree, errors) + yaml.dump(
        document, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=200
    )


class _Dumper(yaml.SafeDumper):
    """Lists are written out each time: yaml-cpp of mag_manip need not follow anchors."""

    def ignore_aliases(self, data: object) -> bool:
        """Whether an object is written out each time: every one is."""
        return True


def _header(request: Request, degree: int, errors: Float[np.ndarray, " coil"]) -> str:
    each = ", ".join(f"{name} {error:.1e}" for name, error in zip(request.magnet.coils, errors, strict=True))
    return (
        "# Multipoles of each coil in the box Workspace_Dimensions (m, world frame), T per A; made by coilcal export.\n"
        f"# Degree {degree}. Largest error at {N_CHECKS + 8} points of the box, as a share of the coil's largest field in it: {each}.\n"
        "# The standard deviation of the calibration comes on top. Outside the box errors grow without bound.\n"
    )


def _box(grid: Grid) -> Box:
    axes = grid.x_m, grid.y_m, grid.z_m
    if min(map(len, axes)) < 2:
        shape = " x ".join(map(str, grid.shape))
        raise InvalidInput(
            f"grid of mpem must have two or more points along each axis, whose ends are the workspace; received {shape}"
        )
    ends = np.array([(axis[0], axis[-1]) for axis in axes])
    return Box(ends[:, 0], ends[:, 1])


def _fit(
    box: Box, points_m: Points, per_ampere: Float[np.ndarray, "point 3 coil"], n_fitted: int
) -> tuple[int, Float[np.ndarray, "source degree coil"], Float[np.ndarray, " coil"]]:
    """Degree, coefficients, and error of each coil at the points after the first `n_fitted`."""
    largest = np.linalg.norm(per_ampere, axis=1).max(0)
    for degree in DEGREES:
        columns = _columns((points_m - box.middle_m) / box.reach_m, degree)
        flat = columns.reshape(len(points_m), 3, -1)
        rows = flat[:n_fitted].reshape(3 * n_fitted, -1)
        solution = np.linalg.lstsq(rows, per_ampere[:n_fitted].reshape(3 * n_fitted, -1), rcond=1e-12)[0]
        left = per_ampere[n_fitted:] - np.einsum("pxk,kc->pxc", flat[n_fitted:], solution)
        errors = np.linalg.norm(left, axis=1).max(0) / np.where(largest > 0.0, largest, 1.0)
        if errors.max() <= ENOUGH:
            break
    powers = box.reach_m ** (1.0 - np.arange(1, degree + 1))
    coefficients = solution.reshape(-1, degree, per_ampere.shape[-1]) * powers[:, None]
    return degree, coefficients, errors


def _directions(degree: int) -> Float[np.ndarray, "source 3"]:
    """Directions that span the harmonics up to a degree, spread over half a sphere by the golden angle."""
    n = 2 * degree + 1
    z = (np.arange(n) + 0.5) / n
    angle, across = GOLDEN_RAD * np.arange(n), np.sqrt(1.0 - z**2)
    return np.stack((across * np.cos(angle), across * np.sin(angle), z), axis=-1)


def _columns(points: Points, degree: int) -> Float[np.ndarray, "point 3 source degree"]:
    """Minus the gradients of r^n P_n, from Bonnet's recursion for these polynomials and its derivative."""
    directions = _directions(degree)
    along, r2 = points @ directions.T, (points**2).sum(-1)[:, None]
    values = [np.ones_like(along), along]
    gradients = [np.zeros((*along.shape, 3)), np.broadcast_to(directions, (*along.shape, 3))]
    for n in range(2, degree + 1):
        first, second = (2 * n - 1) / n, (n - 1) / n
        values.append(first * along * values[-1] - second * r2 * values[-2])
        rising = directions * values[-2][..., None] + along[..., None] * gradients[-1]
        falling = 2.0 * points[:, None] * values[-3][..., None] + r2[..., None] * gradients[-2]
        gradients.append(first * rising - second * falling)
    return -np.stack(gradients[1:], axis=-1).transpose(0, 2, 1, 3)

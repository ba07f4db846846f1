"""The posterior of a plain model to first order: how its numbers move along independent standard normal directions.

A field's standard deviation at a point is then the length of its changes along all directions. That is exact for a normal posterior and
a field that is linear in the coordinates, which hold nearly (docs/decisions/0007). Loop counts count as real numbers here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from estimator.derivatives import jacobian_of
from estimator.export.calibrated import Calibrated
from estimator.export.plain_model import background_of, numbers_of, poses_of, supply_of
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.model.bodies import winding_of
from estimator.model.room_field import at_one_moment
from estimator.model.sources import Sources
from estimator.rig.bodies import WoundCoil
from estimator.rig.coordinates import Coordinates, Values
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

WINDING_NUMBERS = tuple(item.name for item in fields(Winding))
_Numbers = Callable[[Rig, Sources, Values], Tensor]
NEGLIGIBLE = 1e-12  # of the largest variance: directions along which rounding alone moves anything


@dataclass(frozen=True)
class CoilChange:
    """How the numbers of a coil move, one row for each direction of the posterior.

    Attributes:
        winding: Its numbers, in the order of `Winding` or `SidedWinding`.
        base, flange: Shift and small rotation of `world_from_base` and `flange_from_coil` in the axes of world and flange, the rotation
            about the origin of the inner frame.
    """

    winding: Float[Tensor, "direction number"]
    base: Float[Tensor, "direction 6"]
    flange: Float[Tensor, "direction 6"]


@dataclass(frozen=True)
class Linearised:
    """How a plain model moves, one row for each direction of the posterior.

    Attributes:
        coils: Changes of each coil.
        delivered_A_per_A, offset_A, background_T: Changes of what has these names in `PlainModel`.
    """

    coils: tuple[CoilChange, ...]
    delivered_A_per_A: Float[Tensor, "direction coil coil"]
    offset_A: Float[Tensor, "direction coil"]
    background_T: Float[Tensor, "direction 3"]

    @property
    def n_directions(self) -> int:
        """Number of directions in which the posterior has any width."""
        return len(self.background_T)


def linearised(calibrated: Calibrated) -> Linearised:
    """Changes about the best values, by the covariance of the draws in the coordinates of a fit.

    Args:
        calibrated: A calibration that `plain_model` can express.
    """
    rig = calibrated.rig
    coordinates = Coordinates(rig)
    draws = {
        name: torch.from_numpy(np.asarray(array).reshape(-1)) for name, array in calibrated.draws.items()
    }
    at_best = coordinates.vector(calibrated.best)
    vectors = coordinates.vector(draws).expand(np.size(calibrated.log_prob), coordinates.n)
    directions = _directions(vectors)
    sources = at_one_moment(rig)

    def moved(function: _Numbers) -> Tensor:
        """Changes of some numbers along each direction."""
        jacobian = jacobian_of(lambda vector: function(rig, sources, coordinates.values(vector)), at_best)
        return (jacobian @ directions).movedim(-1, 0)

    def moved_coil(coil: WoundCoil) -> CoilChange:
        def base(rig: Rig, sources: Sources, values: Values) -> Tensor:
            return _flat(poses_of(rig, coil, sources, values)[0])

        def flange(rig: Rig, sources: Sources, values: Values) -> Tensor:
            return _flat(poses_of(rig, coil, sources, values)[1])

        def winding(rig: Rig, _: Sources, values: Values) -> Tensor:
            return _winding(rig, coil, values)

        poses = poses_of(rig, coil, sources, coordinates.values(at_best))
        twists = (_twist(pose, moved(of)) for pose, of in zip(poses, (base, flange), strict=True))
        return CoilChange(moved(winding), *twists)

    supply = moved(lambda r, s, v: torch.cat([part.flatten() for part in supply_of(r, s, v)]))
    n = len(rig.coils)
    gains, offset_A = supply.split((n * n, n), dim=-1)
    return Linearised(
        tuple(map(moved_coil, rig.wound)), gains.reshape(-1, n, n), offset_A, moved(background_of)
    )


def _directions(vectors: Float[Tensor, "draw coordinate"]) -> Float[Tensor, "coordinate direction"]:
    """A square root of the covariance of the draws, in units of their standard deviations for the sake of rounding."""
    if not vectors.shape[-1]:
        return torch.zeros(0, 0, dtype=torch.float64)
    centred = vectors - vectors.mean(0)
    sd = centred.square().mean(0).sqrt()
    scaled = centred / torch.where(sd > 0.0, sd, 1.0)
    variances, axes = torch.linalg.eigh(scaled.T @ scaled / len(vectors))
    is_wide = variances > NEGLIGIBLE * variances.max()
    return sd[:, None] * axes[:, is_wide] * variances[is_wide].sqrt()


def _winding(rig: Rig, coil: WoundCoil, values: Values) -> Float[Tensor, " number"]:
    return torch.stack(list(numbers_of(winding_of(rig, coil, values)).values()))


def _flat(pose: Transform) -> Float[Tensor, " 12"]:
    return torch.cat((pose.translation_m, pose.rotation.flatten()))


def _twist(pose: Transform, changes: Float[Tensor, "direction 12"]) -> Float[Tensor, "direction 6"]:
    """Shift and small rotation vector from the changes of a pose's twelve numbers."""
    skew = changes[:, 3:].reshape(-1, 3, 3) @ pose.rotation.mT
    rotation_rad = torch.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), dim=-1)
    return torch.cat((changes[:, :3], rotation_rad), dim=-1)

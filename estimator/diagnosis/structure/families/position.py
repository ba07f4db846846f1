"""Curves in the position of a sensor relative to a coil: smooth ones, and fields of sources outside the workspace."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.structure.families.collection import Collection
from estimator.diagnosis.structure.harmonics import harmonic_gradients
from estimator.diagnosis.structure.smooth import polynomials, unit_interval
from estimator.diagnosis.structure.winding_shapes import shape_fields
from estimator.model.bodies import winding_of
from estimator.rig.rig import AnyCoil, Coil

# Beginnings of the names of these families.
OF_WINDING, OF_POSITION = "the shape of the winding of", "position relative to"


def is_of_coil(family: str) -> bool:
    """Whether a family says that a coil is another source than described.

    Args:
        family: Its name.

    Examples:
        >>> is_of_coil("position relative to coil1, with its current"), is_of_coil("wandering in time")
        (True, False)
    """
    return family.startswith((OF_WINDING, OF_POSITION))


def add_positions(collection: Collection, coil: AnyCoil) -> None:
    """Add fields that move with a coil: arbitrary smooth ones, and those of sources outside the workspace."""
    fit, model = collection.fit, collection.fit.posterior.model
    circumstances = model.circumstances
    all_rows = model.every_row
    with torch.no_grad():
        points_m, sensor_from_coil = model.sensor_in_coil(coil, all_rows, fit.values)
    points_m = points_m.expand(len(all_rows), 3)[model.pose_row]
    if not bool((points_m != points_m[0]).any()):
        return  # coil and sensor do not move relative to each other
    rotation = sensor_from_coil.expand(len(all_rows), 3, 3)[model.pose_row]
    current = circumstances.current_A[:, list(model.rig.coils).index(coil)] / circumstances.largest_current_A
    position = unit_interval(points_m)
    middle = points_m.mean(0)
    inner = (points_m - middle) / (points_m - middle).norm(dim=-1).max()
    fields = [
        torch.einsum("rij,rtj->rti", rotation, harmonic_gradients(inner, degree)) / degree**2
        for degree in range(2, policy.HARMONIC_DEGREE + 1)
    ]
    sources = [torch.cat(fields, dim=1)]
    if isinstance(coil, Coil):
        winding = winding_of(model.rig, coil, fit.values)
        sources.append(torch.einsum("rij,rtj->rti", rotation, dipoles(points_m / winding.radius_m)))
        shapes = torch.einsum("rij,rtj->rti", rotation, shape_fields(points_m, winding))
        collection.add_fields(f"{OF_WINDING} {coil.name}", shapes * current[:, None, None])
    drives = {f"{OF_POSITION} {coil.name}, with its current": current}
    if bool((current.abs() != current.abs()[0]).any() or (current != current[0]).any()):
        drives[f"{OF_POSITION} {coil.name}, without current"] = torch.ones_like(current)
    for name, drive in drives.items():
        collection.add(name, polynomials(position, 1, policy.SMOOTH_DEGREE) * drive[:, None], rotation)
        collection.add(name, polynomials(position, 1, policy.COARSE_DEGREE) * drive[:, None], rotation)
        for source in sources:
            collection.add_fields(name, source * drive[:, None, None])


def dipoles(points: Float[Tensor, "reading 3"]) -> Float[Tensor, "reading column 3"]:
    """Fields of dipoles along each axis in and around a coil of radius 1, which move with it."""
    positions = [(0, 0, -0.3), (1.2, 0, -0.6), (-1.2, 0, -0.6), (0, 1.2, -0.6), (0, -1.2, -0.6), (0, 0, -2.0)]
    columns = []
    for position in positions:
        arm = points - points.new_tensor(position)
        r2 = (arm**2).sum(-1, keepdim=True)
        for axis in range(3):
            moment = torch.eye(3).to(points)[axis]
            columns.append((3.0 * arm[:, axis : axis + 1] * arm - r2 * moment) * r2**-2.5)
    return torch.stack(columns, dim=1)

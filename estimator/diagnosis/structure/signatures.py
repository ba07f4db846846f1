"""Physical signatures of a residual: what it moves with, how it depends on the current, and whether it can be a magnetic field.

Each signature compares the evidence of several flexible descriptions. It narrows down what is wrong even where no known cause fits. Of
several causes together it shows the largest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.covariates import predicted_T, sensor_in_room
from estimator.diagnosis.structure.curves import Collection, axes_of, before, dipoles, harmonic_gradients
from estimator.diagnosis.structure.smooth import legendre, polynomials, unit_interval
from estimator.model.bodies import round_winding_of
from estimator.rig.bodies import AnyCoil

SIGNATURE_DEGREES = (
    1,
    2,
    3,
)  # of the polynomials that describe what a residual stays with: several, so that none pays for more
TIME_DEGREE = 6  # of polynomials in time: three periods of what swings during a session
HARMONIC_DEGREE = 5  # of the fields that sources outside the workspace make

SAME = 1e-6
FLAT = 1e-3  # thickness over length of places in a plane: a stage wanders by as much

Evidence = dict[str, float]


@dataclass(frozen=True)
class Signatures:
    """Log evidence of each description against pure noise; None where the session cannot tell.

    Attributes:
        stays_with: the name of a coil, constant, room, sensor, clock, path.
        current: independent, odd, even, cubic.
        field_equations: a magnetic field (div B = 0, curl B = 0 where the sensor was), or any other vector field.
    """

    stays_with: Evidence
    current: Evidence | None
    field_equations: Evidence | None


def signatures(fit: Fit) -> Signatures:
    """Signatures of the residual of a fit."""
    return Signatures(_stays_with(fit), _current(fit), _field_equations(fit))


def leading(evidence: Evidence | None) -> list[str]:
    """The answers about as good as the best; none where even the best is no better than noise."""
    if not evidence:
        return []
    best = max(evidence.values())
    if best < policy.CLEAR_LOG_EVIDENCE:
        return []
    return [name for name, value in evidence.items() if value > best - policy.CLEAR_LOG_EVIDENCE]


def _stays_with(fit: Fit) -> Evidence:
    circumstances = fit.circumstances
    field_T = predicted_T(fit)
    constant = field_T.new_ones(len(circumstances), 1)
    axes = axes_of(fit)
    largest_T = field_T.abs().max().clamp(min=1e-12)
    along_field = torch.diag_embed(field_T / largest_T)
    collection = Collection(fit)
    for coil, position_m, rotation, drive in _around_coils(fit):
        for degree in SIGNATURE_DEGREES:
            position = polynomials(unit_interval(position_m), degree)
            collection.add(coil.name, position * drive[:, None], rotation)
            collection.add(coil.name, position, rotation)
    collection.add("constant", constant, axes)
    position_m, sensor_from_world = sensor_in_room(fit)
    for degree in SIGNATURE_DEGREES:
        collection.add("room", polynomials(unit_interval(position_m), degree - 1), sensor_from_world)
        collection.add("sensor", polynomials(unit_interval(field_T), degree), axes)
    time = 2.0 * circumstances.hours / circumstances.duration_h - 1.0
    for degree in (1, TIME_DEGREE):
        collection.add("clock", legendre(time, degree), axes)
        collection.add("clock", legendre(time, degree), torch.cat((axes, along_field), dim=-1))
    change = (before(field_T, circumstances.observations.row) - field_T) / largest_T
    rolled = [torch.diag_embed(torch.roll(change, k, dims=1)) for k in range(3)]
    collection.add("path", constant, torch.cat(rolled, dim=-1))
    return collection.evidence()


def _current(fit: Fit) -> Evidence | None:
    collection = Collection(fit)
    for _, position_m, rotation, drive in _around_coils(fit):
        if float(drive.max() - drive.min()) < SAME:
            continue
        sizes = torch.unique((drive.abs() / SAME).round())
        for degree in SIGNATURE_DEGREES:
            position = polynomials(unit_interval(position_m), degree)
            collection.add("independent", position, rotation)
            collection.add("odd", position * drive[:, None], rotation)
            if len(sizes) > 1:
                collection.add("even", position * drive[:, None] ** 2, rotation)
            if len(sizes[sizes > 0.0]) > 1:
                collection.add("cubic", position * drive[:, None] ** 3, rotation)
    return collection.evidence() if collection.curves else None


def _field_equations(fit: Fit) -> Evidence | None:
    collection = Collection(fit)
    for coil, position_m, rotation, drive in _around_coils(fit):
        if _are_flat(position_m):
            continue  # in a plane or on a line any vector field can be magnetic
        middle_m = position_m.mean(0)
        inner = (position_m - middle_m) / (position_m - middle_m).norm(dim=-1).max()
        sources = [harmonic_gradients(inner, degree) / degree**2 for degree in range(1, HARMONIC_DEGREE + 1)]
        fields_of_sources = [torch.cat(sources, dim=1)]
        if (winding := round_winding_of(fit.rig, coil, fit.values)) is not None:
            fields_of_sources.append(dipoles(position_m / winding.radius_m))
        for drive_factor in (drive, torch.ones_like(drive)):
            for fields in fields_of_sources:
                rotated = torch.einsum("rij,rtj->rti", rotation, fields)
                collection.add_fields("a magnetic field", rotated * drive_factor[:, None, None])
            for degree in SIGNATURE_DEGREES:
                position = polynomials(unit_interval(position_m), degree)
                collection.add("no magnetic field", position * drive_factor[:, None], rotation)
    return collection.evidence() if collection.curves else None


def _are_flat(position_m: Float[Tensor, "reading 3"]) -> bool:
    """Whether places lie in a plane or on a line, however that is turned."""
    extents = torch.linalg.svdvals(position_m - position_m.mean(0))
    return bool(extents[-1] <= FLAT * extents[0])


def _around_coils(fit: Fit) -> Iterator[tuple[AnyCoil, Tensor, Tensor, Tensor]]:
    """Each coil with the places of the sensor in its frame, the rotations sensor_from_coil, and its current over the largest."""
    circumstances = fit.circumstances
    for i, coil in enumerate(fit.rig.coils):
        position_m, coil_from_sensor = fit.posterior.model.readings_in_coil(coil, fit.values)
        drive = circumstances.current_A[:, i] / circumstances.largest_current_A
        yield coil, position_m, coil_from_sensor.mT, drive


WORDS: Mapping[str, str] = {
    "constant": "is the same in all readings",
    "room": "stays in the room",
    "sensor": "depends on the field that the sensor reads, not on its position",
    "clock": "changes with time",
    "path": "depends on the previous reading, so on the path taken",
    "independent": "is present without current",
    "odd": "is proportional to the current (odd)",
    "even": "is proportional to the square of the current (even)",
    "cubic": "grows with the cube of the current (cubic)",
    "a magnetic field": "obeys div B = 0 and curl B = 0 where the sensor was: it can be the field of a source",
    "no magnetic field": "violates div B = 0 or curl B = 0 where the sensor was: an error of sensor, position or time, not a steady source",
}


def words(answer: str) -> str:
    """The answer as the end of a sentence that begins with `The residual`."""
    return WORDS.get(answer, f"depends on the position as seen from {answer}, or on its current")

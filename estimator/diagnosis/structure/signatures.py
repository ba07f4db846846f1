"""Physical signatures of a residual: what it stays with, how it goes with the current, and whether it can be a magnetic field.

Each answer is a set of flexible descriptions whose evidence is compared. They say what kind of thing is wrong also where no known cause
fits, and hold for the residual as it is: of several causes at once they show the largest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_mean_exp
from estimator.diagnosis.structure.covariates import predicted_T, sensor_in_coils, sensor_in_room
from estimator.diagnosis.structure.discrepancy import (
    Collection,
    Family,
    before,
    dipoles,
    evidence_by_amplitude,
)
from estimator.diagnosis.structure.harmonics import harmonic_gradients
from estimator.diagnosis.structure.smooth import legendre, polynomials, unit_interval
from estimator.model.bodies import winding_of
from estimator.rig.rig import Coil

SAME = 1e-6

Evidence = dict[str, float]


@dataclass(frozen=True)
class Signatures:
    """Log evidence against pure noise of each description; None where the session does not show it.

    Attributes:
        stays_with: the name of a coil, constant, room, sensor, clock, path.
        current: independent, odd, even, cubic.
        field_equations: a magnetic field (div B = 0, curl B = 0 where the sensor was), or any other field of vectors.
    """

    stays_with: Evidence
    current: Evidence | None
    field_equations: Evidence | None


def signatures(fit: Fit) -> Signatures:
    """Of the residual of a fit."""
    return Signatures(_stays_with(fit), _current(fit), _field_equations(fit))


def leading(evidence: Evidence | None) -> list[str]:
    """The answers that are as good as the best; none where even that is no better than noise."""
    if not evidence:
        return []
    best = max(evidence.values())
    if best < policy.CLEAR_LOG_EVIDENCE:
        return []
    return [name for name, value in evidence.items() if value > best - policy.CLEAR_LOG_EVIDENCE]


def _stays_with(fit: Fit) -> Evidence:
    circumstances = fit.posterior.model.circumstances
    field_T = predicted_T(fit)
    one = torch.ones(len(circumstances), 1, dtype=torch.float64)
    each = torch.eye(3, dtype=torch.float64).expand(len(circumstances), 3, 3)
    largest_T = field_T.abs().max().clamp(min=1e-12)
    own = torch.diag_embed(field_T / largest_T)
    found = Collection(fit)
    for i, (coil, place_m) in enumerate(sensor_in_coils(fit).items()):
        turn = _sensor_from_coil(fit, fit.rig.coils[i])
        for degree in policy.SIGNATURE_DEGREES:
            place = polynomials(unit_interval(place_m), 0, degree)
            found.add(coil, place * _drive(fit, i)[:, None], turn)
            found.add(coil, place, turn)
    found.add("constant", one, each)
    place_m, sensor_from_world = sensor_in_room(fit)
    for degree in policy.SIGNATURE_DEGREES:
        found.add("room", polynomials(unit_interval(place_m), 0, degree - 1), sensor_from_world)
        found.add("sensor", polynomials(unit_interval(field_T), 0, degree), each)
    time = 2.0 * circumstances.hours / circumstances.duration_h - 1.0
    for degree in (1, policy.TIME_DEGREE):
        found.add("clock", legendre(time, degree), each)
        found.add("clock", legendre(time, degree), torch.cat((each, own), dim=-1))
    change = (before(field_T, circumstances.observations.row) - field_T) / largest_T
    rolled = [torch.diag_embed(torch.roll(change, k, dims=1)) for k in range(3)]
    found.add("path", one, torch.cat(rolled, dim=-1))
    return _evidence(fit, found.families)


def _current(fit: Fit) -> Evidence | None:
    circumstances = fit.posterior.model.circumstances
    found = Collection(fit)
    for i, place_m in enumerate(sensor_in_coils(fit).values()):
        drive = _drive(fit, i)
        turn = _sensor_from_coil(fit, fit.rig.coils[i])
        if float(drive.max() - drive.min()) < SAME:
            continue
        sizes = torch.unique((drive.abs() / SAME).round())
        for degree in policy.SIGNATURE_DEGREES:
            place = polynomials(unit_interval(place_m), 0, degree)
            found.add("independent", place, turn)
            found.add("odd", place * drive[:, None], turn)
            if len(sizes) > 1:
                found.add("even", place * drive[:, None] ** 2, turn)
            if len(sizes[sizes > 0.0]) > 1:
                found.add("cubic", place * drive[:, None] ** 3, turn)
    return _evidence(fit, found.families) if found.families and len(circumstances) else None


def _field_equations(fit: Fit) -> Evidence | None:
    found = Collection(fit)
    for i, place_m in enumerate(sensor_in_coils(fit).values()):
        if bool((unit_interval(place_m).std(0) < SAME).any()):
            continue  # in a plane or on a line every field may be one of sources
        turn = _sensor_from_coil(fit, fit.rig.coils[i])
        drive = _drive(fit, i)
        middle_m = place_m.mean(0)
        inner = (place_m - middle_m) / (place_m - middle_m).norm(dim=-1).max()
        sources = [
            harmonic_gradients(inner, degree) / degree**2 for degree in range(1, policy.HARMONIC_DEGREE + 1)
        ]
        near = dipoles(place_m / winding_of(fit.rig, fit.rig.coils[i], fit.values).radius_m)
        for now in (drive, torch.ones_like(drive)):
            for fields in (torch.cat(sources, dim=1), near):
                turned = torch.einsum("rij,rtj->rti", turn, fields)
                found.add_fields("a magnetic field", turned * now[:, None, None])
            for degree in policy.SIGNATURE_DEGREES:
                place = polynomials(unit_interval(place_m), 0, degree)
                found.add("no magnetic field", place * now[:, None], turn)
    return _evidence(fit, found.families) if found.families else None


def _evidence(fit: Fit, families: list[Family]) -> Evidence:
    parts: dict[str, list[Tensor]] = {}
    for family in families:
        parts.setdefault(family.name, []).append(evidence_by_amplitude(fit, family))
    return {name: log_mean_exp(torch.cat(values)) for name, values in parts.items()}


def _drive(fit: Fit, coil: int) -> Float[Tensor, " reading"]:
    circumstances = fit.posterior.model.circumstances
    return circumstances.current_A[:, coil] / circumstances.largest_current_A


def _sensor_from_coil(fit: Fit, coil: Coil) -> Float[Tensor, "reading 3 3"]:
    model = fit.posterior.model
    everywhere = torch.arange(len(model.sensor))
    with torch.no_grad():
        _, rotation = model.sensor_in_coil(coil, everywhere, fit.values)
    return rotation.expand(len(everywhere), 3, 3)[model.pose_row]


WORDS: Mapping[str, str] = {
    "constant": "is the same in all readings",
    "room": "stays in the room",
    "sensor": "is a matter of what the sensor reads, wherever it is",
    "clock": "goes with time",
    "path": "depends on the reading before, so on the path taken",
    "independent": "is there without current",
    "odd": "is proportional to the current (odd)",
    "even": "goes with the square of the current (even)",
    "cubic": "grows faster than the current (cubic)",
    "a magnetic field": "obeys div B = 0 and curl B = 0 where the sensor was: it can be the field of a source",
    "no magnetic field": "violates div B = 0 or curl B = 0 where the sensor was: no steady source does that; sensor, positions or time may",
}


def words(answer: str) -> str:
    """What an answer means: `The residual ...`."""
    return WORDS.get(answer, f"moves with {answer}")

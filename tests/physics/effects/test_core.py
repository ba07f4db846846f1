"""Iron cores against cubes of iron with the moment method, and against what simpler formulas say of their limits."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.field.core import BANDS, HEIGHTS, demagnetisation, share_of_heights
from estimator.field.saturation import SUSCEPTIBILITY, played, polarisation_T
from tests.hidden.iron_cells import IronRod, field_per_T, polarisations_T
from tests.physics.effects.laboratory import (
    MU0_RATIO,
    added_T,
    dipole_T,
    effects_text,
    predicted_T,
    readings,
    winding,
)

# A core in each of two coils that look at each other askew; places in front of both.
RIG = """
schema_version: 1
name: cores
movers: {mapper: {motion: pose}}
coils:
  coil: {radius_mm: 26, wire_radius_mm: 0.5, axial_loops: 40, radial_loops: 10}
  other: {radius_mm: 26, wire_radius_mm: 0.5, axial_loops: 40, radial_loops: 10, world_from_coil: {x_mm: 30, z_mm: 80, ry_deg: 210}}
sensors:
  probe: {carried_by: mapper, noise_uT: 5}
"""
POINTS_M = np.array([[0.0, 0.0, 0.04], [0.012, -0.01, 0.035], [-0.02, 0.01, 0.045], [0.05, 0.03, 0.02]])
IRON = {"strength": 500.0 / 520.0, "radius_m": 0.01, "length_m": 0.05, "front_m": 0.004, "saturation_T": 1.5}
PLACES = (
    (Rotation.identity(), np.zeros(3)),
    (Rotation.from_euler("y", 210, degrees=True), np.array([0.03, 0.0, 0.08])),
)
WOUND = winding(0.026, 40, 10)
ACROSS = {1: 6, 2: 4}  # cubes across a core, by the number of cores: a finer pair takes a minute


def rods(n: int = 2) -> list[IronRod]:
    return [
        IronRod(IRON["radius_m"], IRON["length_m"], IRON["front_m"], ACROSS[n], *place)
        for place in PLACES[:n]
    ]


def of_coils(currents_A: tuple[float, float], points_m: np.ndarray) -> np.ndarray:
    total = np.zeros_like(points_m)
    for current_A, (turn, at_m) in zip(currents_A, PLACES, strict=True):
        total += current_A * turn.apply(WOUND.field_T(turn.inv().apply(points_m - at_m)))
    return total


def of_cubes(currents_A: tuple[float, float], n: int = 2) -> np.ndarray:
    bodies = rods(n)
    applied = [
        of_coils(currents_A, body.rotation.apply(body.centres_m) + body.position_m)[None] for body in bodies
    ]
    limit_T, chi = IRON["saturation_T"], 500.0
    polarisations = polarisations_T(bodies, applied, lambda size_T: 1.0 / (chi * (1.0 - size_T / limit_T)))
    parts = [
        np.einsum("pwcj,cj->pw", field_per_T(body, POINTS_M), polarisation[0])
        for body, polarisation in zip(bodies, polarisations, strict=True)
    ]
    return MU0_RATIO * np.sum(parts, axis=0)


@pytest.mark.parametrize("current_A", [0.5, 10.0])
def test_core_in_its_own_coil_is_that_of_cubes(current_A):
    """At ten amperes it gives a tenth less per ampere."""
    field_T = added_T(readings(POINTS_M, (current_A, 0.0)), {"cross_magnetisation[coil]": IRON}, RIG)
    error = np.linalg.norm(field_T - of_cubes((current_A, 0.0), 1), axis=1) / np.linalg.norm(field_T, axis=1)
    assert error.max() < 0.015


@pytest.mark.parametrize("currents_A", [(0.0, 6.0), (6.0, 6.0), (-6.0, 6.0)])
def test_pair_of_cores_is_that_of_cubes(currents_A):
    """The core of a coil without current answers its neighbour, and the cores answer each other."""
    cores = {"cross_magnetisation[coil]": IRON, "cross_magnetisation[other]": IRON}
    field_T = added_T(readings(POINTS_M, currents_A), cores, RIG)
    error_T = np.linalg.norm(field_T - of_cubes(currents_A), axis=1)
    assert error_T.max() < 0.015 * np.linalg.norm(field_T, axis=1).max()


def test_core_of_an_idle_coil_shows():
    idle_T = added_T(readings(POINTS_M, (0.0, 6.0)), {"cross_magnetisation[coil]": IRON}, RIG)
    assert np.linalg.norm(idle_T, axis=1).max() > 4e-5


def test_weak_core_is_a_dipole_of_its_volume_and_field():
    far_m = 20.0 * POINTS_M
    weak = {**IRON, "strength": 1e-4, "radius_m": 0.002, "length_m": 0.006, "front_m": -0.01}
    field_T = added_T(readings(far_m, (1.0, 0.0)), {"cross_magnetisation[coil]": weak}, RIG)
    at_m = np.array([[0.0, 0.0, -0.013]])
    volume_m3 = np.pi * 0.002**2 * 0.006
    chi = SUSCEPTIBILITY * 1e-4 / (1.0 - 1e-4)
    moment_A_m2 = chi * volume_m3 * WOUND.field_T(at_m)[0] / (4e-7 * np.pi)
    np.testing.assert_allclose(
        field_T, dipole_T(moment_A_m2, at_m[0], far_m), rtol=0.03, atol=1e-3 * np.abs(field_T).max()
    )


@pytest.mark.parametrize("slenderness", [1.0, 3.0, 10.0])
def test_even_magnetisation_has_the_factor_of_the_literature(slenderness):
    """Of length over diameter: N = 0.3116 at 1 (Chen, Brug and Goldfarb 1991, table I), 4/(3 pi g) - 1/(8 g^2) for long ones."""
    matrix = demagnetisation(*torch.tensor([1.0, 2.0 * slenderness], dtype=torch.float64))
    across = float(matrix[HEIGHTS, HEIGHTS])
    along = 1.0 - 2.0 * across
    expected = {1.0: 0.3116}.get(
        slenderness, 4.0 / (3.0 * np.pi * slenderness) - 1.0 / (8.0 * slenderness**2)
    )
    assert along == pytest.approx(expected, rel=3e-3)
    # Even along the axis: nothing fans out, so that charge sits on the faces only and the mean field is the same.
    share = share_of_heights(matrix) / BANDS
    assert float(share @ matrix[:HEIGHTS, :HEIGHTS].sum(1)) == pytest.approx(along, rel=0.06)


def test_mutual_energies_are_symmetric_and_positive():
    matrix = demagnetisation(*torch.tensor([0.01, 0.06], dtype=torch.float64))[:HEIGHTS, :HEIGHTS]
    energy = share_of_heights(matrix)[:, None] * matrix
    torch.testing.assert_close(energy, energy.mT, rtol=1e-9, atol=1e-12)
    assert float(torch.linalg.eigvalsh(energy).min()) > 0.0


def test_solution_lies_on_the_curve_for_any_iron_and_field():
    matrix = demagnetisation(*torch.tensor([0.01, 0.07], dtype=torch.float64))
    along = (torch.arange(len(matrix)) < HEIGHTS).double()
    for strength in (0.1, 0.9, 0.999):
        for field_T in (1e-4, 0.1, 3.0):
            applied_T = field_T * torch.linspace(1.0, 0.2, len(matrix), dtype=torch.float64)
            s = torch.full_like(applied_T, strength)
            found_T = polarisation_T(applied_T, matrix, s, along / 1.8)
            inside_T = applied_T - matrix @ found_T
            response_T = SUSCEPTIBILITY * s / (1.0 - s) * inside_T
            expected_T = response_T / (1.0 + response_T.abs() * along.clamp(min=1e-30) / 1.8)
            torch.testing.assert_close(found_T, expected_T, rtol=1e-7, atol=1e-9)


def test_play_follows_as_one_pushed_step_by_step():
    random = torch.Generator().manual_seed(5)
    drive = torch.randn(100, generator=random, dtype=torch.float64).cumsum(0)
    held, expected = 0.0, []
    for value in drive.tolist():
        held = min(max(held, value - 0.7), value + 0.7)
        expected.append(held)
    torch.testing.assert_close(played(drive, torch.tensor(0.7)), torch.tensor(expected, dtype=torch.float64))


def test_core_keeps_the_field_of_its_coercive_current():
    """After 5 A the coil is off: the core stands as it stands on the way up at 0.2 A more than its play."""
    cores = {"cross_magnetisation[coil]": IRON, "core_remanence[coil]": {"coercive_A": 0.2}}
    at = readings(
        np.repeat(POINTS_M[:1], 4, axis=0), np.array([[1.0, 0.0], [5.0, 0.0], [0.0, 0.0], [-5.0, 0.0]])
    )
    field_T = added_T(at, cores, RIG)
    alone = {"cross_magnetisation[coil]": IRON}
    seen_A = np.array([[0.8, 0.0], [4.8, 0.0], [0.2, 0.0], [-4.8, 0.0]])
    expected_T = added_T(readings(np.repeat(POINTS_M[:1], 4, axis=0), seen_A), alone, RIG)
    np.testing.assert_allclose(field_T, expected_T, rtol=1e-9)


def test_core_of_a_carried_coil_answers_where_it_is():
    """Each pose by itself gives the same as all poses together."""
    carried = (
        RIG.replace("movers: {", "movers: {arm: {motion: pose}, ")
        .replace("other: {", "other: {carried_by: arm, ")
        .replace("world_from_coil: {x_mm", "flange_from_coil: {x_mm")
    )
    cores = {"cross_magnetisation[coil]": IRON, "cross_magnetisation[other]": IRON}
    together = readings(POINTS_M, (3.0, -4.0))
    together.motion["arm"] = torch.tensor(
        [[0.01 * i, 0.0, 0.02 * i, 0.0, 0.1 * i, 0.0] for i in range(len(POINTS_M))]
    ).double()
    text = effects_text(cores)
    all_T = predicted_T(together, None, carried + text)
    for i in range(len(POINTS_M)):
        one = readings(POINTS_M[i : i + 1], (3.0, -4.0))
        one.motion["arm"] = together.motion["arm"][i : i + 1]
        np.testing.assert_allclose(predicted_T(one, None, carried + text)[0], all_T[i], rtol=1e-8, atol=1e-18)


def test_a_body_without_a_solution_has_no_field_and_stops_no_fit():
    """Perfect iron that nothing demagnetises is no core; one of a batch like that leaves the others as they are."""
    applied_T = torch.full((2, 1), 0.1, dtype=torch.float64)
    demagnetisation = torch.tensor([[[0.0]], [[0.3]]], dtype=torch.float64)
    one, none = torch.ones(2, 1, dtype=torch.float64), torch.zeros(2, 1, dtype=torch.float64)
    polarisation = polarisation_T(applied_T, demagnetisation, one, none)
    assert bool(torch.isnan(polarisation[0, 0]))
    assert float(polarisation[1, 0]) == pytest.approx(0.1 / 0.3)

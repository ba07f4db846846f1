"""Fields of coils without a winding: against formulas and loops of other code, and where they have no meaning."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
import torch
from scipy.special import lpmv
from torch import Tensor
from torch.func import jacrev, vmap

from estimator.effects import EFFECTS
from estimator.errors import InvalidInput
from estimator.model.coil_field import unwound_field
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField
from estimator.model.unit_gate import check_units
from estimator.readings.observations import Observations
from estimator.rig.bodies import HarmonicCoil
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.harmonic_terms import terms
from estimator.rig_files.read import rig_from_text

RADIUS_M = 0.05
TEXT = """
schema_version: 1
name: box
movers: {stage: {motion: pose}}
coils:
  c1:
    model: harmonic
    region: interior
    degree: 4
    reference_radius_mm: 50
    amplitudes: {sd_T_per_A: 1e-3}
    world_from_coil: {x_mm: 10, rx_deg: 30}
sensors: {hall: {carried_by: stage, noise_uT: 1}}
"""
EXTERIOR = TEXT.replace("interior", "exterior")
WITH_WINDING = TEXT.replace(
    "sensors:",
    "  c2: {radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 10, radial_loops: 2, world_from_coil: {z_mm: -200}}\nsensors:",
)


def gradient_of_potential(
    points: np.ndarray, degree: int, m: int, is_sine: bool, is_inside: bool
) -> np.ndarray:
    """Gradient of r^l P_lm cos(m phi), or of the same with r^-(l+1), in spherical components turned into Cartesian ones."""
    r = np.linalg.norm(points, axis=1)
    cos, phi = points[:, 2] / r, np.arctan2(points[:, 1], points[:, 0])
    sin = np.sqrt(1.0 - cos**2)
    power = degree if is_inside else -degree - 1
    legendre = (-1.0) ** m * lpmv(m, degree, cos)
    below = (-1.0) ** m * lpmv(m, degree - 1, cos) if degree > m else np.zeros_like(cos)
    by_theta = (degree * cos * legendre - (degree + m) * below) / sin
    wave, slope = (
        (np.sin(m * phi), m * np.cos(m * phi)) if is_sine else (np.cos(m * phi), -m * np.sin(m * phi))
    )
    radial = power * r ** (power - 1) * legendre * wave
    polar, around = r ** (power - 1) * by_theta * wave, r ** (power - 1) * legendre * slope / sin
    axes = (
        np.stack((sin * np.cos(phi), sin * np.sin(phi), cos), 1),
        np.stack((cos * np.cos(phi), cos * np.sin(phi), -sin), 1),
        np.stack((-np.sin(phi), np.cos(phi), 0.0 * phi), 1),
    )
    return sum(part[:, None] * axis for part, axis in zip((radial, polar, around), axes, strict=True))  # type: ignore[return-value]


def sphere() -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of a mean over the unit sphere."""
    cos, weight = np.polynomial.legendre.leggauss(20)
    phi = 2 * np.pi * (np.arange(40) + 0.3) / 40
    c, p = (g.ravel() for g in np.meshgrid(cos, phi, indexing="ij"))
    s = np.sqrt(1 - c**2)
    return np.stack((s * np.cos(p), s * np.sin(p), c), 1), np.repeat(0.5 * weight, 40) / 40


def coil_and_values(text: str, amplitudes: dict[str, float]) -> tuple[HarmonicCoil, dict[str, Tensor]]:
    rig = rig_from_text(text)
    rig = rig.with_values({f"c1.{key}": value for key, value in amplitudes.items()})
    return rig.unwound[0], nominal_tensors(rig)


@pytest.mark.parametrize("text", [TEXT, EXTERIOR])
@pytest.mark.parametrize("degree", [1, 2, 4])
def test_each_term_is_the_gradient_of_its_potential_with_rms_one_at_the_reference_sphere(text, degree):
    rng = np.random.default_rng(degree)
    directions = rng.normal(size=(30, 3))
    points = directions / np.linalg.norm(directions, axis=1)[:, None] * rng.uniform(0.3, 2.0, (30, 1))
    on_sphere, weight = sphere()
    for term in terms(degree):
        m, is_sine = int(term[3:]), term.startswith("sin")
        arguments = (degree, m, is_sine, text is TEXT)
        rms = np.sqrt((weight * (gradient_of_potential(on_sphere, *arguments) ** 2).sum(1)).sum())
        expected = 2e-3 * gradient_of_potential(points, *arguments) / rms
        coil, values = coil_and_values(text, {f"degree{degree}_{term}_T_per_A": 2e-3})
        field = unwound_field(coil, values).by(None)(torch.from_numpy(points * RADIUS_M))
        np.testing.assert_allclose(field.numpy(), expected, rtol=1e-10, atol=1e-16)


@pytest.mark.parametrize("text", [TEXT, EXTERIOR])
def test_divergence_and_curl_vanish(text):
    rig = rig_from_text(text)
    names = [name for own in rig.unwound[0].amplitudes.values() for name in own]
    rng = np.random.default_rng(0)
    values = nominal_tensors(rig) | {
        n: torch.tensor(v, dtype=torch.float64) for n, v in zip(names, rng.normal(size=24), strict=True)
    }
    points_m = torch.from_numpy(rng.normal(size=(20, 3))) * 0.06

    def at(point_m: Tensor) -> Tensor:
        return unwound_field(rig.unwound[0], values).by(None)(point_m[None])[0]

    gradient = vmap(jacrev(at))(points_m)
    size = gradient.abs().amax((-1, -2))
    assert (gradient.diagonal(dim1=-2, dim2=-1).sum(-1).abs() / size).max() < 1e-12
    assert ((gradient - gradient.mT).abs().amax((-1, -2)) / size).max() < 1e-12


def test_multipoles_fitted_to_a_loop_of_magpylib_give_its_field_farther_away():
    loop = magpylib.current.Circle(diameter=0.04, current=1.0, position=(0.005, 0.0, -0.004))
    coil, values = coil_and_values(EXTERIOR.replace("degree: 4", "degree: 8"), {})
    names = [name for own in coil.amplitudes.values() for name in own]
    each = torch.eye(len(names), dtype=torch.float64)
    on_sphere, _ = sphere()

    def columns(points_m: np.ndarray) -> np.ndarray:
        unit = values | {name: each[i] for i, name in enumerate(names)}
        return unwound_field(coil, unit).by(None)(torch.from_numpy(points_m)).flatten(1).T.numpy()

    near, far = 1.2 * RADIUS_M * on_sphere, 3.0 * RADIUS_M * on_sphere
    amplitudes = np.linalg.lstsq(columns(near), loop.getB(near).ravel(), rcond=None)[0]
    expected = loop.getB(far).ravel()
    assert np.abs(columns(far) @ amplitudes - expected).max() < 1e-5 * np.abs(expected).max()


def readings(places_m: list[list[float]], current_A: list[float]) -> Observations:
    n = len(places_m)
    pose = torch.cat((torch.tensor(places_m).double(), torch.zeros(n, 3).double()), 1)
    return Observations.of(
        torch.tensor([current_A] * n).double(), {"stage": pose}, torch.full((n, 3), 1e-3).double()
    )


def test_readings_among_the_sources_or_far_beyond_the_reference_sphere_are_refused():
    inside, outside = rig_from_text(TEXT), rig_from_text(EXTERIOR)
    MeasurementModel.build(inside, readings([[0.01, 0.0, 0.14]], [1.0]))
    with pytest.raises(InvalidInput, match=r"within 3 times the reference_radius of c1, 50 mm.*reading 1"):
        MeasurementModel.build(inside, readings([[0.0, 0.0, 0.0], [14.0, 0.0, 0.0]], [1.0]))
    MeasurementModel.build(outside, readings([[0.01, 0.0, 0.06]], [1.0]))
    with pytest.raises(
        InvalidInput, match=r"outside the reference_radius of c1, 50 mm, which holds all its sources"
    ):
        MeasurementModel.build(outside, readings([[0.01, 0.0, 0.04]], [1.0]))


def test_the_room_has_no_field_among_the_sources():
    rig = rig_from_text(EXTERIOR).with_values({"c1.degree1_cos0_T_per_A": 1e-3})
    points_m = torch.tensor([[0.01, 0.0, 0.04], [0.01, 0.0, 0.06]]).double()
    room = RoomField(rig, nominal_tensors(rig), points_m)
    field_T = room.field_T(nominal_tensors(rig), torch.ones(1).double())
    assert torch.isnan(field_T).all(-1).tolist() == [True, False]


def test_a_coil_with_a_winding_beside_it_adds_its_field():
    rig = rig_from_text(WITH_WINDING).with_values({"c1.degree1_cos0_T_per_A": 1e-3})
    points_m = torch.tensor([[0.0, 0.0, 0.02]]).double()
    room = RoomField(rig, nominal_tensors(rig), points_m)
    one, other, both = (
        room.field_T(nominal_tensors(rig), torch.tensor(current_A).double())
        for current_A in ([2.0, 0.0], [0.0, 3.0], [2.0, 3.0])
    )
    torch.testing.assert_close(both, one + other)
    assert one.norm() == pytest.approx(2e-3)  # uniform, whatever way it points


def test_units_are_judged_by_readings_of_windings_alone():
    rig = rig_from_text(WITH_WINDING)
    places = [[0.0, 0.0, 0.001 * i] for i in range(5)]
    check_units(
        rig, readings(places, [5.0, 1.0]), "here"
    )  # 1 mT, of which the winding makes a few microtesla
    with pytest.raises(InvalidInput, match="ratio"):
        check_units(rig, readings(places, [0.0, 1.0]), "here")


def test_causes_that_need_a_winding_have_no_place_at_a_coil_without_one():
    rig = rig_from_text(WITH_WINDING)
    at = {name: effect.places(rig) for name, effect in EFFECTS.items()}
    assert {name for name, places in at.items() if "c1" in places} >= {"current_gain", "neighbour_coil"}
    needing = {name for name, effect in EFFECTS.items() if effect.needs_winding}
    assert {"winding_misstated", "hidden_winding", "magnetised_link"} <= needing
    assert all(
        "c1" not in at[name] for name in (*needing, "coil_harmonics", "coil_multipoles", "sides_misstated")
    )
    assert at["winding_misstated"] == ("c2",)

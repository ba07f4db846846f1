"""Coordinates and the numbers of a rig: there and back, densities, and what a column means."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.func import jacfwd

from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

HEAD = "schema_version: 1\nname: test\n"
WHOLE_WINDING = """
    radius_mm: {prior: {normal: {mean: 51, sd: 3, lower: 30}}}
    wire_radius_mm: {prior: {normal: {mean: 0.49, sd: 0.03, lower: 0.2}}}
    axial_loops: {prior: {normal: {mean: 48, sd: 3, lower: 1}}}
    radial_loops: {prior: {normal: {mean: 25, sd: 2, lower: 1}}}
    world_from_coil: {z_mm: {prior: {normal: {mean: -40, sd: 3}}}, tilt_x_deg: {prior: {normal: {mean: 0, sd: 2}}}}
"""
NOISE = "sensors: {hall: {noise_uT: {prior: {log_normal: {median: 20, relative_sd: 0.5}}}}}\n"
RIGS = {
    "one coil, all natural": f"coils:\n  coil1:{WHOLE_WINDING}{NOISE}",
    "radius only": "coils: {coil1: {radius_mm: {prior: {uniform: {lower: 40, upper: 60}}}, wire_radius_mm: 0.5, "
    f"axial_loops: 9, radial_loops: 5}}}}\n{NOISE}",
    "wire fixed, counts free": "coils: {coil1: {radius_mm: {prior: {normal: {mean: 51, sd: 3}}}, wire_radius_mm: 0.5, "
    "axial_loops: {prior: {normal: {mean: 48, sd: 3, lower: 1}}}, radial_loops: {prior: {normal: {mean: 25, sd: 2, lower: 1}}}}}\n"
    f"{NOISE}",
    "own pitches": "coils: {coil1: {radius_mm: {prior: {normal: {mean: 51, sd: 3}}}, axial_pitch_mm: 1.74, "
    "radial_pitch_mm: {prior: {log_normal: {median: 1.06, relative_sd: 0.1}}}, axial_loops: 9, "
    f"radial_loops: {{prior: {{normal: {{mean: 8, sd: 1, lower: 1}}}}}}}}}}\n{NOISE}",
    "two coils, one tied to the other": f"""
coils:
  coil1:{WHOLE_WINDING}    current_gain: {{prior: {{normal: {{mean: 1, sd: 0.01}}}}}}
  coil2:
    radius_mm: {{tied_to: coil1.radius_m, factor: 1.1}}
    wire_radius_mm: {{tied_to: coil1.wire_radius_m}}
    axial_loops: {{prior: {{normal: {{mean: 30, sd: 2, lower: 1}}}}}}
    radial_loops: 10
    current_gain: {{tied_to: coil1.current_gain}}
    world_from_coil: {{x_mm: {{tied_to: coil1.world_from_coil.z_m, factor: -2}}}}
{NOISE}""",
    "two coils, both natural": f"coils:\n  coil1:{WHOLE_WINDING}  coil2:{WHOLE_WINDING}{NOISE}",
}
EVERY_RIG = pytest.mark.parametrize("text", RIGS.values(), ids=RIGS)
BOTH_KINDS = pytest.mark.parametrize("integer_counts", [False, True], ids=["real counts", "whole counts"])


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def rig(text: str) -> Rig:
    return rig_from_text(HEAD + text)


def prior_vectors(coordinates: Coordinates, number: int, seed: int = 0) -> Tensor:
    return coordinates.sample_prior(np.random.default_rng(seed), number)


@EVERY_RIG
@BOTH_KINDS
def test_values_and_vectors_are_inverse_to_each_other(text, integer_counts):
    coordinates = Coordinates(rig(text), integer_counts)
    vectors = prior_vectors(coordinates, 12).reshape(3, 4, -1)
    values = coordinates.values(vectors)
    torch.testing.assert_close(coordinates.vector(values), vectors, rtol=1e-12, atol=1e-14)
    free = {name: values[name] for name in coordinates.names}
    again = coordinates.values(coordinates.vector(free))
    for name, value in values.items():
        torch.testing.assert_close(again[name], value, rtol=1e-12, atol=1e-15)


@EVERY_RIG
@BOTH_KINDS
def test_values_of_coordinates_that_stand_apart_are_the_same(text, integer_counts):
    coordinates = Coordinates(rig(text), integer_counts)
    vectors = prior_vectors(coordinates, 5)
    columns = [column.clone().requires_grad_() for column in vectors.unbind(-1)]
    values = coordinates.values_of_each(columns)
    for name, value in coordinates.values(vectors).items():
        torch.testing.assert_close(values[name], value, rtol=1e-13, atol=1e-16)
    noise = columns[coordinates.names.index("hall.noise_T")] if "hall.noise_T" in coordinates.names else None
    if noise is not None:
        others = [column for column in columns if column is not noise]
        gradients = torch.autograd.grad(values["hall.noise_T"].sum(), others, allow_unused=True)
        assert all(gradient is None for gradient in gradients)


@EVERY_RIG
@BOTH_KINDS
def test_start_holds_the_nominal_values(text, integer_counts):
    of = rig(text)
    coordinates = Coordinates(of, integer_counts)
    values = coordinates.values(coordinates.start())
    assert set(values) == set(of.parameters)
    for name, value in of.nominal_values().items():
        assert values[name].item() == pytest.approx(value, rel=1e-12, abs=1e-15)


@EVERY_RIG
@BOTH_KINDS
def test_log_prior_is_the_density_of_the_parameters_times_the_jacobian(text, integer_counts):
    """The Jacobian is that of central differences; whole-numbered counts are no continuous coordinates and have none."""
    coordinates = Coordinates(rig(text), integer_counts)
    n, names = coordinates.n_continuous, coordinates.names
    vectors = prior_vectors(coordinates, 8)

    def parameters(vector: Tensor) -> Tensor:
        values = coordinates.values(vector)
        return torch.stack([values[name] for name in names[:n]])

    def expected(vector: Tensor) -> float:
        step = 1e-6 * coordinates.scale[:n]
        columns = []
        for i in range(n):
            shift = torch.zeros_like(vector)
            shift[i] = step[i]
            columns.append((parameters(vector + shift) - parameters(vector - shift)) / (2.0 * step[i]))
        log_det = torch.linalg.slogdet(torch.stack(columns, -1)).logabsdet.item()
        values = coordinates.values(vector)
        densities = (p.prior.log_density(values[p.name]).item() for p in coordinates.parameters if p.prior)
        return sum(densities) + log_det

    ours = coordinates.log_prior(vectors)
    differences = np.array([o - expected(v) for o, v in zip(ours.tolist(), vectors, strict=True)])
    np.testing.assert_allclose(differences, differences[0], atol=1e-6)
    assert ours.std() > 0.1


@EVERY_RIG
def test_prior_is_zero_where_a_parameter_leaves_its_bounds(text):
    coordinates = Coordinates(rig(text))
    inside = coordinates.start()
    assert torch.isfinite(coordinates.log_prior(inside))
    values = coordinates.values(inside)
    bounded = [p for p in coordinates.parameters if 0.0 < p.prior.lower < math.inf]
    assert bounded
    for parameter in bounded:
        outside = coordinates.vector({**values, parameter.name: tensor(0.99 * parameter.prior.lower)})
        assert coordinates.log_prior(outside).isneginf(), parameter.name


@EVERY_RIG
@BOTH_KINDS
def test_scale_is_the_spread_that_the_prior_gives_each_coordinate(text, integer_counts):
    """To first order: what a standard deviation of each parameter moves, by central differences, added in squares."""
    of = rig(text)
    coordinates = Coordinates(of, integer_counts)
    nominal = tensor([of.nominal_values()[name] for name in coordinates.names])

    def vector(values: Tensor) -> Tensor:
        return coordinates.vector(dict(zip(coordinates.names, values, strict=True)))

    shifts = torch.diag(tensor([1e-4 * parameter.prior.sd for parameter in coordinates.parameters]))
    slope = torch.stack([(vector(nominal + s) - vector(nominal - s)) / 2e-4 for s in shifts], -1)
    torch.testing.assert_close(coordinates.scale, slope.norm(dim=1), rtol=1e-6, atol=0.0)


def test_natural_coordinates_are_thickness_turns_length_rms_radius_and_middle():
    coordinates = Coordinates(rig(RIGS["one coil, all natural"]))
    values = {
        "coil1.radius_m": 0.051,
        "coil1.wire_radius_m": 0.0005,
        "coil1.axial_loops": 47.0,
        "coil1.radial_loops": 26.0,
    }
    by_label = dict(zip(coordinates.labels, coordinates.vector(values).tolist(), strict=True))
    thickness_over_pitch, length_over_pitch = (
        0.0005 * 26.0,
        0.0005 * 47.0,
    )  # without the constant 2 of the pitch
    assert by_label["coil1 rms radius"] == pytest.approx(
        math.sqrt(np.mean((0.051 - 0.0005 - 0.001 * np.arange(26)) ** 2)), rel=1e-12
    )
    assert by_label["coil1 winding thickness"] == pytest.approx(math.log(thickness_over_pitch), rel=1e-12)
    assert by_label["coil1 turns"] == pytest.approx(math.log(47.0 * 26.0), rel=1e-12)
    assert by_label["coil1 winding length"] == pytest.approx(math.log(length_over_pitch), rel=1e-12)
    assert by_label["hall.noise_T"] == pytest.approx(math.log(20e-6), rel=1e-12)
    middle_m = -0.04 - 0.5 * 0.001 * 47.0
    assert by_label["coil1.world_from_coil.z_m of the winding's middle"] == pytest.approx(middle_m, rel=1e-12)


def test_with_whole_counts_they_are_the_last_columns_as_they_are():
    coordinates = Coordinates(rig(RIGS["two coils, both natural"]), integer_counts=True)
    counts = ("coil1.axial_loops", "coil1.radial_loops", "coil2.axial_loops", "coil2.radial_loops")
    assert coordinates.names[-4:] == coordinates.labels[-4:] == counts
    assert (coordinates.n_counts, coordinates.n_continuous) == (4, coordinates.n - 4)
    assert coordinates.start()[-4:].tolist() == [48.0, 25.0, 48.0, 25.0]
    draws = prior_vectors(coordinates, 50)[:, -4:]
    assert torch.equal(draws, draws.round())
    assert draws.min() >= 1.0
    assert draws.std(0).min() > 1.0


def test_ties_follow_what_they_are_tied_to():
    coordinates = Coordinates(rig(RIGS["two coils, one tied to the other"]))
    values = coordinates.values(prior_vectors(coordinates, 5))
    torch.testing.assert_close(values["coil2.radius_m"], 1.1 * values["coil1.radius_m"])
    torch.testing.assert_close(values["coil2.axial_pitch_m"], 2.0 * values["coil1.wire_radius_m"])
    torch.testing.assert_close(
        values["coil2.world_from_coil.x_m"], -2.0 * values["coil1.world_from_coil.z_m"]
    )
    assert not any(name.startswith("coil2.radius") for name in coordinates.names)


def test_fixed_values_carry_no_batch_and_a_rig_without_free_ones_has_no_columns():
    coordinates = Coordinates(rig(RIGS["radius only"]))
    values = coordinates.values(prior_vectors(coordinates, 5))
    assert values["coil1.radius_m"].shape == (5,)
    assert values["coil1.axial_loops"].shape == ()
    fixed = Coordinates(
        rig(
            "coils: {coil1: {radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}}\nsensors: {hall: {noise_uT: 1}}"
        )
    )
    assert (fixed.n, fixed.names, fixed.start().shape, fixed.scale.shape) == (0, (), (0,), (0,))
    assert fixed.values(fixed.start())["coil1.radius_m"].item() == 0.05


@EVERY_RIG
@BOTH_KINDS
def test_slopes_of_values_are_those_of_the_whole_transform(text, integer_counts):
    coordinates = Coordinates(rig(text), integer_counts)
    vector = coordinates.sample_prior(np.random.default_rng(3), 1)[0]

    def values(point: Tensor) -> Tensor:
        by_name = coordinates.values(point)
        return torch.stack([by_name[name] for name in coordinates.names])

    torch.testing.assert_close(
        coordinates.slopes_of_values(vector),
        jacfwd(values)(vector)[:, : coordinates.n_continuous],
        rtol=1e-12,
        atol=1e-15,
    )


@pytest.mark.parametrize(
    ("prior", "whole"),
    [
        ("{uniform: {lower: 10.6, upper: 12.4}}", {11.0, 12.0}),
        ("{normal: {mean: 12, sd: 1, lower: 11.4, upper: 12.4}}", {12.0}),
        ("{normal: {mean: 1, sd: 2}}", None),
        ("{uniform: {lower: 40.2, upper: 40.8}}", set()),
    ],
)
@BOTH_KINDS
def test_loop_counts_that_are_drawn_lie_inside_their_prior(rig_text, prior, whole, integer_counts):
    text = rig_text.replace("{prior: {normal: {mean: 12, sd: 1, lower: 1}}}", f"{{prior: {prior}}}")
    coordinates = Coordinates(rig_from_text(text), integer_counts)
    vectors = prior_vectors(coordinates, 200)
    assert torch.isfinite(coordinates.log_prior(vectors)).all()
    counts = coordinates.values(vectors)["coil1.axial_loops"].round(decimals=9)
    if whole is None:
        assert (counts >= 1.0).all()
        assert (counts == counts.round()).all()
    elif whole:
        assert set(counts.tolist()) == whole

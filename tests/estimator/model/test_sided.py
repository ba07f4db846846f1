"""Rigs whose coils have straight sides: readings, fields in the room, rules by distance, derivatives, coordinates and causes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from estimator.derivatives import jacobian_of
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.errors import InvalidInput
from estimator.field.coil import field_of_coil
from estimator.field.node_sum import SumMode
from estimator.field.sided import distance_to_sided
from estimator.field.zones import rules_by_level, zones_of
from estimator.model.bodies import winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import load_plan
from estimator.rig.coordinates import Coordinates, nominal_tensors
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig, rig_from_text
from tests.estimator.field.test_sided import MAGPYLIB_OVER_OURS, loops_by_magpylib
from tests.estimator.rig_files.test_sided import TEXT

CONFIGS = Path(__file__).parents[3] / "configs"
CURRENT_A = torch.tensor([2.0, -3.0], dtype=torch.float64)


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def readings(motion: Tensor) -> Observations:
    n = len(motion)
    return Observations.of(CURRENT_A.expand(n, 2), {"arm": motion}, torch.zeros(n, 3, dtype=torch.float64))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(
        TEXT.replace("flange_from_coil: {z_mm: 30}", "flange_from_coil: {x_mm: 90, rz_deg: 30}")
    )


@pytest.fixture(scope="module")
def motion() -> Tensor:
    """Of the coil on the arm, past a sensor in the bore of the other one."""
    rng = np.random.default_rng(0)
    return tensor(np.hstack((rng.uniform(-0.01, 0.01, (12, 3)), rng.uniform(-0.3, 0.3, (12, 3)))))


def test_readings_are_those_of_magpylib_loops_in_their_places(rig, motion):
    model = MeasurementModel.build(rig, readings(motion), tolerance=1e-9)
    found_T = model.predict(nominal_tensors(rig))
    values = nominal_tensors(rig)
    moved, standing = (
        loops_by_magpylib(winding_of(rig, coil, values), n)
        for coil, n in zip(rig.wound, (1, 181), strict=True)
    )
    expected_T = np.zeros((len(motion), 3))
    for i, row in enumerate(motion.numpy()):
        turn = Rotation.from_rotvec(row[3:])
        coil = turn * Rotation.from_rotvec([0.0, 0.0, np.deg2rad(30.0)])
        at_m = row[:3] + turn.apply([0.09, 0.0, 0.0])
        expected_T[i] = 2.0 * coil.apply(moved.getB(coil.inv().apply(-at_m))) - 3.0 * standing.getB(
            [0.0, 0.0, 0.0]
        )
    scale = np.linalg.norm(expected_T, axis=1).max()
    np.testing.assert_allclose(
        found_T.numpy(), expected_T / MAGPYLIB_OVER_OURS, rtol=0.0, atol=1e-5 * scale
    )  # chords


def test_field_in_the_room_is_what_a_sensor_there_would_read(rig, motion):
    values = nominal_tensors(rig)
    found_T = MeasurementModel.build(rig, readings(motion), tolerance=1e-9).predict(values)
    for i in range(3):
        room = RoomField(rig, values, torch.zeros(1, 3).double(), {"arm": motion[i]}, tolerance=1e-9)
        torch.testing.assert_close(room.field_T(values, CURRENT_A)[0], found_T[i], rtol=1e-8, atol=0.0)


def test_points_in_a_winding_have_no_field_and_sensors_there_are_refused(rig, motion):
    in_wire_m = tensor([[0.0, 0.0215, -5e-3], [0.0, 0.0195, -5e-3]])
    room = RoomField(rig, nominal_tensors(rig), in_wire_m)
    field_T = room.field_T(nominal_tensors(rig), CURRENT_A)
    assert torch.isnan(field_T).all(1).tolist() == room.is_inside.tolist() == [True, False]
    there = torch.zeros_like(motion)  # the sensor in the middle of c1, but for one reading
    there[:, :3] = tensor([-0.09, 0.0, 5e-3])
    across_m = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(30.0)]).apply([0.0, 0.0215, 0.0])
    there[3, :3] -= tensor(across_m)
    with pytest.raises(InvalidInput, match="outside the winding of c1"):
        MeasurementModel.build(rig, readings(there))


@pytest.mark.parametrize("coil", [0, 1])
def test_rules_by_distance_keep_their_tolerance(rig, coil):
    winding = winding_of(rig, rig.wound[coil], nominal_tensors(rig))
    points_m = tensor(np.random.default_rng(3).uniform(-0.12, 0.12, (1500, 3)))
    distance_m = distance_to_sided(points_m, winding)
    points_m = points_m[distance_m > 5e-4]
    for zone in zones_of(winding, distance_to_sided(points_m, winding), 1e-6):
        at_m = points_m[zone.points]
        full = rules_by_level(winding, 0.0)[1][0]
        field, expected = (field_of_coil(rig.wound[coil], winding, rule)(at_m) for rule in (zone.rule, full))
        assert ((field - expected).norm(dim=1) < 1e-6 * expected.norm(dim=1)).all()


@pytest.mark.whole
def test_derivatives_of_a_fit_are_those_of_the_plain_model():
    rig = load_rig(CONFIGS / "rectangular_helmholtz.yaml")
    plan = load_plan(CONFIGS / "plans/rectangular_helmholtz.yaml", rig)
    observations = simulate(rig, plan, {}, seed=0).rows(torch.arange(0, 400, 11))
    coordinates, model = Coordinates(rig), MeasurementModel.build(rig, observations)
    first, plain = (
        jacobian_of(lambda v, m=mode: model.with_mode(m).predict(coordinates.values(v)), coordinates.start())
        for mode in (SumMode.FIRST_ORDER, SumMode.PLAIN)
    )
    scale = plain.abs().amax((0, 1))
    noise = [name.endswith("noise_T") for name in coordinates.names]
    assert (scale > 0.0).tolist() == [not each for each in noise]
    assert ((first - plain).abs() <= 1e-9 * scale).all()


def test_coordinates_are_those_of_the_mean_loop_and_lead_back():
    text = TEXT.replace("wire_radius_mm: 0.5", "wire_radius_mm: {prior: {normal: {mean: 0.5, sd: 0.02}}}")
    rig = rig_from_text(
        text.replace("inner_side_y_cm: 4", "inner_side_y_cm: {prior: {normal: {mean: 4, sd: 0.1}}}")
    )
    coordinates = Coordinates(rig)
    start = dict(zip(coordinates.names, coordinates.start().tolist(), strict=True))
    assert start["c1.inner_side_x_m"] == pytest.approx(
        0.064
    )  # four layers of 1 mm on either side of half of it
    assert "c1 side x of the mean loop" in coordinates.labels
    draws = coordinates.sample_prior(np.random.default_rng(0), 20)
    values = coordinates.values(draws)
    torch.testing.assert_close(coordinates.vector(values), draws, rtol=1e-12, atol=1e-15)
    assert torch.isfinite(coordinates.log_prior(draws)).all()


def test_causes_of_a_round_winding_have_no_place_but_those_of_any_coil_do(rig):
    at = {name: set(effect.places(rig)) for name, effect in EFFECTS.items()}
    assert all(
        at[name] >= {"c1", "c2"}
        for name in ("current_gain", "neighbour_coil", "coil_misplaced", "coil_heating")
    )
    assert not any(at[name] & {"c1", "c2"} for name, effect in EFFECTS.items() if effect.needs_winding)
    assert at["iron_plate"] == {"room"}


def test_a_core_in_a_round_coil_feels_one_with_straight_sides():
    text = """
schema_version: 1
name: a core beside a rectangle
coils:
  core: {radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 20, radial_loops: 4}
  sided: {MODEL, wire_radius_mm: 0.5, axial_loops: 10, radial_loops: 4, world_from_coil: {z_mm: 60}}
sensors: {hall: {noise_uT: 5}}
effects: {"cross_magnetisation[core]": {QUANTITIES}}
"""
    core = EFFECTS["cross_magnetisation"]
    quantities = ", ".join(
        f"{q.key}: {q.prior.centre if q.is_positive or q.is_shape else 0.5}"
        for q in core.quantities(Extent())
    )
    shapes = (
        "radius_mm: 30",
        "model: racetrack, inner_side_x_mm: 52, inner_side_y_mm: 52, inner_corner_radius_mm: 26",
    )
    point_m, current_A = tensor([[0.01, 0.0, 0.02]]), tensor([0.0, 1.0])
    fields = []
    for shape in shapes:
        rig = rig_from_text(text.replace("QUANTITIES", quantities).replace("MODEL", shape))
        values = nominal_tensors(rig)
        fields.append(RoomField(rig, values, point_m, tolerance=1e-9).field_T(values, current_A)[0])
    alone = rig_from_text(text.partition("effects")[0].replace("MODEL", shapes[0]))
    without = RoomField(alone, nominal_tensors(alone), point_m).field_T(nominal_tensors(alone), current_A)[0]
    assert (fields[0] - without).norm() > 1e-3 * without.norm()  # the core answers
    error = (fields[1] - fields[0]).norm()
    assert error < 1e-4 * fields[0].norm()  # few nodes stand for the winding in a core

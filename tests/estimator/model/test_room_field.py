"""Field in the room: the same as the measurement model's, with gaps inside windings, batches and movers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.model import room_field
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField, some_at_a_time
from estimator.readings.observations import Observations
from estimator.rig.bodies import FieldSum
from estimator.rig.coordinates import Coordinates, Values
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

COILS = """
coils:
  coil1: {radius_mm: {prior: {normal: {mean: 51, sd: 1}}}, wire_radius_mm: 0.49, axial_loops: 12, radial_loops: 8,
          carried_by: arm, flange_from_coil: {z_mm: {prior: {normal: {mean: 60, sd: 2}}}}}
  coil2: {radius_mm: 40, axial_pitch_mm: 1.74, radial_pitch_mm: 1.06, axial_loops: 12, radial_loops: 9,
          current_gain: {prior: {normal: {mean: 1.01, sd: 0.01}}}, world_from_coil: {x_mm: 70, y_mm: -30, z_mm: 90, rx_deg: 150}}
sensors: {hall: {noise_uT: 20, carried_by: probe}}
"""
MOVERS = """
movers:
  arm: {motion: pose, world_from_base: {z_mm: -80, tilt_y_deg: 5}}
  probe: {motion: pose}
"""
HEAD = "schema_version: 1\nname: room\n"
CURRENT_A = torch.tensor([1.5, -2.0], dtype=torch.float64)
IN_COIL1 = [0.0516, 0.0, -0.0302]  # middle of the cross-section with the arm at zeros
ARM = torch.tensor([0.01, -0.02, 0.0, 0.1, -0.2, 0.3], dtype=torch.float64)


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def values_of(rig: Rig) -> Values:
    return {name: tensor(value) for name, value in rig.nominal_values().items()}


@pytest.fixture
def rig() -> Rig:
    return rig_from_text(HEAD + MOVERS + COILS)


@pytest.fixture
def points_m() -> Tensor:
    points = np.random.default_rng(0).uniform(-0.05, 0.05, size=(12, 3))
    return tensor(points) + tensor([0.0, 0.0, 0.03])


@pytest.mark.parametrize("field_sum", FieldSum)
def test_field_is_what_a_sensor_carried_there_would_read(rig, points_m, field_sum):
    rig = replace(rig, coils=tuple(replace(coil, field_sum=field_sum) for coil in rig.coils))
    n = len(points_m)
    probe = torch.cat((points_m, torch.zeros_like(points_m)), 1)
    observations = Observations.of(CURRENT_A.expand(n, 2), {"arm": ARM.expand(n, 6), "probe": probe})
    expected = MeasurementModel.build(rig, observations, tolerance=1e-12).predict(values_of(rig))
    room = RoomField(rig, values_of(rig), points_m, {"arm": ARM}, tolerance=1e-12)
    torch.testing.assert_close(room.field_T(values_of(rig), CURRENT_A), expected, rtol=1e-10, atol=1e-18)


def test_tolerance_is_met(rig, points_m):
    exact, rough = (
        RoomField(rig, values_of(rig), points_m, tolerance=t).field_T(values_of(rig), tensor([1.0, 0.0]))
        for t in (1e-12, 1e-4)
    )
    error = ((rough - exact).norm(dim=1) / exact.norm(dim=1)).max().item()
    assert 1e-9 < error < 1e-4


def test_points_inside_a_winding_have_no_field_and_the_others_keep_theirs(rig, points_m):
    values = values_of(rig)
    mixed = torch.cat((points_m[:3], tensor([IN_COIL1]), points_m[3:]))
    room = RoomField(rig, values, mixed)
    assert room.is_inside.nonzero().flatten().tolist() == [3]
    field, gradient = room.field_T(values, CURRENT_A), room.gradient_T_per_m(values, CURRENT_A)
    assert torch.isnan(field[3]).all()
    assert torch.isnan(gradient[3]).all()
    outside = RoomField(rig, values, points_m)
    assert not outside.is_inside.any()
    keep = ~room.is_inside
    torch.testing.assert_close(field[keep], outside.field_T(values, CURRENT_A), rtol=1e-6, atol=0.0)
    assert torch.isfinite(gradient[keep]).all()


def test_all_points_inside_one_winding_give_no_field_instead_of_a_failure(rig):
    values = values_of(rig)
    room = RoomField(rig, values, tensor([IN_COIL1]))
    assert torch.isnan(room.field_T(values, CURRENT_A)).all()


def test_gradient_is_the_limit_of_central_differences(rig, points_m):
    values = values_of(rig)
    room = RoomField(rig, values, points_m, {"arm": ARM})
    gradient = room.gradient_T_per_m(values, CURRENT_A)

    def error(step: float) -> float:
        columns = [
            (room.field_T(values, CURRENT_A, points_m + s) - room.field_T(values, CURRENT_A, points_m - s))
            / (2.0 * step)
            for s in step * torch.eye(3).double()
        ]
        difference = (torch.stack(columns, -1) - gradient).flatten(1).norm(dim=1)
        return (difference / gradient.flatten(1).norm(dim=1)).max().item()

    assert error(2e-4) / error(1e-4) == pytest.approx(4.0, rel=0.1)
    assert error(4e-6) < 1e-6


def test_movers_carry_the_coils_and_stand_at_zeros_unless_told(rig, points_m):
    values = values_of(rig)

    def field(motion: dict[str, Tensor] | None) -> Tensor:
        return RoomField(rig, values, points_m, motion, 1e-12).field_T(values, tensor([1.0, 0.0]))

    assert torch.equal(field(None), field({"arm": torch.zeros(6, dtype=torch.float64)}))
    away = tensor([0.0, 0.0, -0.05, 0.0, 0.0, 0.0])
    assert (field({"arm": away}).norm(dim=1) < 0.7 * field(None).norm(dim=1)).all()


def test_batches_of_parameter_sets_and_of_currents_equal_one_by_one(rig, points_m):
    coordinates = Coordinates(rig)
    vectors = coordinates.sample_prior(np.random.default_rng(1), 4)
    room = RoomField(rig, values_of(rig), points_m)
    together = room.field_T(coordinates.values(vectors), CURRENT_A)
    gradients = room.gradient_T_per_m(coordinates.values(vectors), CURRENT_A)
    assert (together.shape, gradients.shape) == ((4, 12, 3), (4, 12, 3, 3))
    for i, vector in enumerate(vectors):
        values = coordinates.values(vector)
        torch.testing.assert_close(together[i], room.field_T(values, CURRENT_A), rtol=1e-12, atol=1e-20)
        gradient = room.gradient_T_per_m(values, CURRENT_A)
        torch.testing.assert_close(gradients[i], gradient, rtol=1e-11, atol=1e-16)
    currents = torch.stack((CURRENT_A, 2.0 * CURRENT_A, tensor([0.0, 1.0])))
    together = room.field_T(values_of(rig), currents)
    assert together.shape == (3, 12, 3)
    for i, current in enumerate(currents):
        torch.testing.assert_close(together[i], room.field_T(values_of(rig), current), rtol=1e-12, atol=1e-20)


def test_draws_some_at_a_time_give_what_all_give_together(rig, points_m, monkeypatch):
    """With a block that ends in the middle, and without a batch where nothing depends on the draws."""
    values = values_of(rig)
    room = RoomField(rig, values, points_m)
    radius_m = values["coil1.radius_m"] * torch.linspace(0.99, 1.01, 7, dtype=torch.float64)
    draws = {**values, "coil1.radius_m": radius_m}
    together = room.field_T(draws, CURRENT_A)
    monkeypatch.setattr(room_field, "DRAWS_AND_POINTS", 3 * len(points_m))
    asked: list[int] = []

    def at(some: Values) -> Tensor:
        asked.append(len(some["coil1.radius_m"]))
        return room.field_T(some, CURRENT_A)

    torch.testing.assert_close(some_at_a_time(at, draws, len(points_m), 2), together)
    assert asked == [3, 3, 1]
    best = room.field_T(values, CURRENT_A)
    assert torch.equal(some_at_a_time(lambda _: best, draws, len(points_m), 2), best)

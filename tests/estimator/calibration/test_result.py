"""A calibrated model: its field, its gradient and their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.rig.parameters import Normal
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

pytestmark = pytest.mark.whole
ON = {"coil1": 3.0}
NO_READINGS = Observations.of(torch.zeros(0, 1, dtype=torch.float64))


@pytest.fixture
def points_m() -> Tensor:
    return 0.06 * (torch.rand(40, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 0.5)


def at(rig: Rig, values: dict[str, float]) -> Calibration:
    """A calibration that knows the rig's numbers exactly."""
    best = rig.with_values(values).nominal_values()
    draws = {parameter.name: np.full((2, 3), best[parameter.name]) for parameter in rig.free}
    return Calibration(rig, NO_READINGS, best, draws, np.zeros((2, 3)), {})


def test_the_field_is_that_of_the_readings_that_were_simulated(small_rig, small_plan, small_truth):
    """The coil displaced by d sees the sensor at the origin as the coil at rest sees the point -d."""
    readings = simulate(small_rig, small_plan, small_truth | {"hall.noise_T": 0.0}, seed=0)
    model = at(small_rig, small_truth)
    field_T = model.field(-readings.motion["arm1"][:, :3], ON)
    torch.testing.assert_close(field_T, readings.field_sensor_T, rtol=1e-5, atol=0.0)
    moved = model.field(torch.zeros(1, 3).double(), ON, {"arm1": readings.motion["arm1"][4]})
    torch.testing.assert_close(moved[0], readings.field_sensor_T[4], rtol=1e-5, atol=0.0)


def test_of_coils_alone_the_field_and_its_interval_have_no_part_of_the_room(small_rig, rig_text, points_m):
    """Where no sensor turned, the room's field is known as badly as the zeros of the sensors."""
    room = "background_field[room]"
    rig = rig_from_text(f"{rig_text}effects:\n  {room}: {{x_T: 0, y_T: 0, z_T: -43.0e-6}}\n")
    rig = rig.with_parameters([replace(rig.parameters[f"{room}.z_T"], prior=Normal(0.0, 1e-4))])
    both, plain = at(rig, {}), at(small_rig, {})
    both.draws[f"{room}.z_T"][:] = -43e-6 + 50e-6 * np.array([-1.0, 0.0, 1.0])
    alone = both.coils_alone()
    torch.testing.assert_close(alone.field(points_m, ON), plain.field(points_m, ON))
    assert both.field(points_m, {})[:, 2] == pytest.approx(-43e-6)
    assert not alone.field(points_m, {}).any()
    widths_T = [
        float(torch.diff(torch.stack(model.field_interval(points_m, ON)), dim=0).amax())
        for model in (both, alone)
    ]
    assert widths_T[0] > 80e-6
    assert widths_T[1] < 1e-12


def test_the_field_is_linear_in_the_current_and_zero_without(small_calibration, points_m):
    field_T = small_calibration.field(points_m, ON)
    torch.testing.assert_close(small_calibration.field(points_m, {"coil1": -6.0}), -2 * field_T)
    assert not small_calibration.field(points_m, {}).any()


def test_points_inside_the_winding_have_no_field_and_all_others_have(small_calibration):
    best = small_calibration.best
    face_m, radius_m = best["coil1.world_from_coil0.z_m"], best["coil1.radius_m"]
    middle = [radius_m - 0.003, 0.0, face_m - 0.01]
    points_m = torch.tensor(
        [
            middle,
            [0.0, 0.0, face_m - 0.01],
            [radius_m - 0.003, 0.0, face_m + 0.001],
            [radius_m + 0.001, 0.0, face_m - 0.01],
            [radius_m - 0.007, 0.0, face_m - 0.01],
        ],
        dtype=torch.float64,
    )
    lower, upper = small_calibration.field_interval(points_m, ON)
    for field in (
        small_calibration.field(points_m, ON),
        lower,
        upper,
        small_calibration.gradient(points_m, ON).flatten(1),
    ):
        assert torch.isnan(field[0]).all()
        assert torch.isfinite(field[1:]).all()
    assert torch.isnan(small_calibration.field(points_m[:1], ON)).all()


def test_an_interval_holds_its_share_of_the_posterior(small_calibration, points_m):
    draws = {name: values.ravel()[::4] for name, values in small_calibration.draws.items()}
    exact = (
        at(small_calibration.rig, dict(zip(draws, map(float, row), strict=True)))
        for row in zip(*draws.values(), strict=True)
    )
    fields = torch.stack([model.field(points_m, ON) for model in exact])
    for level in (0.5, 0.9):
        lower, upper = small_calibration.field_interval(points_m, ON, level)
        strong = fields.abs().mean(0) > 1e-6
        share = ((fields >= lower) & (fields <= upper)).double().mean(0)[strong]
        assert share.mean().item() == pytest.approx(level, abs=5 * (level * (1 - level) / len(fields)) ** 0.5)


def test_a_posterior_over_noise_alone_has_a_field_without_width(rig_text, points_m):
    text = rig_text
    for prior, value in (
        ("normal: {mean: 51, sd: 1}", "51"),
        ("normal: {mean: 12, sd: 1, lower: 1}", "12"),
        ("normal: {mean: -40, sd: 3}", "-40"),
    ):
        text = text.replace(f"{{prior: {{{prior}}}}}", value)
    rig = rig_from_text(
        text.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 5, relative_sd: 1}}}")
    )
    model = at(rig, {})
    lower, upper = model.field_interval(points_m, ON)
    torch.testing.assert_close(lower, model.field(points_m, ON))
    assert torch.equal(lower, upper)


@pytest.mark.parametrize("level", [0.0, 1.0, 90.0, -0.1, float("nan")])
def test_a_level_outside_0_to_1_is_refused(small_calibration, points_m, level):
    with pytest.raises(InvalidInput, match="level must lie between 0 and 1; received"):
        small_calibration.field_interval(points_m, ON, level)


@pytest.mark.parametrize(
    ("currents_A", "motion", "message"),
    [
        ({"coil2": 1.0}, None, r"currents must name coils of the rig \(coil1\); received 'coil2'"),
        ({"coil1": float("nan")}, None, "current of coil1 must be a number between .*; received nan"),
        (ON, {"arm2": [0.0] * 6}, r"motion must name movers of the rig \(arm1\); received 'arm2'"),
        (ON, {"arm1": [0.0] * 5 + [float("inf")]}, "motion of arm1 must be six numbers between .*; received"),
    ],
)
def test_what_the_rig_has_not_is_refused(small_calibration, points_m, currents_A, motion, message):
    stands = motion and {name: torch.tensor(values, dtype=torch.float64) for name, values in motion.items()}
    for predict in (small_calibration.field, small_calibration.gradient):
        with pytest.raises(InvalidInput, match=message):
            predict(points_m, currents_A, stands)
    with pytest.raises(InvalidInput, match=message):
        small_calibration.field_interval(points_m, currents_A, motion=stands)


def test_points_that_are_not_finite_are_refused(small_calibration):
    with pytest.raises(InvalidInput, match="points must be finite"):
        small_calibration.field(torch.tensor([[0.0, float("nan"), 0.0]]).double(), ON)


def test_a_robot_that_carries_a_coil_must_be_told_where_it_stands(rig_text, points_m):
    """Zeros are the reference configuration of displacements, but no posture that anybody means for joint angles."""
    joints = rig_text.replace("displacement", "UR3").replace("world_from_coil0", "flange_from_coil")
    model = at(rig_from_text(joints), {})
    with pytest.raises(
        InvalidInput, match=r"motion of arm1 must be given \(arm1_q0_rad, .*\): it carries a coil"
    ):
        model.field(points_m, ON)
    assert torch.isfinite(model.field(points_m, ON, {"arm1": torch.zeros(6).double()})).all()

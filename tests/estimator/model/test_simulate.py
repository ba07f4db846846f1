"""Simulated readings: the truth decides the field, the sensor's noise the scatter, the seed everything random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.errors import InvalidInput
from estimator.model.simulate import draw_truth, perfect_readings, simulate
from estimator.rig_files.read import rig_from_text

pytestmark = pytest.mark.whole

MU0 = 1.25663706212e-6


def test_without_noise_the_centre_of_the_coil_reads_the_sum_of_its_loops(small_rig, small_plan):
    truth = {"hall.noise_T": 0.0, "coil1.axial_loops": 4.0, "coil1.world_from_coil0.z_m": -0.03}
    o = simulate(small_rig, small_plan, truth, seed=0)
    on_axis = (o.motion["arm1"][:, :2] == 0.0).all(dim=1)
    pitch_m = 2 * 0.00098
    for field_T, shift_m in zip(o.field_sensor_T[on_axis], o.motion["arm1"][on_axis, 2], strict=True):
        heights_m = 0.03 - shift_m.item() + pitch_m * (np.arange(4) + 0.5)
        radii_m = 0.051 - pitch_m * (np.arange(3) + 0.5)
        loops = radii_m**2 / (radii_m**2 + heights_m[:, None] ** 2) ** 1.5
        assert field_T[2].item() == pytest.approx(0.5 * MU0 * 3.0 * loops.sum(), rel=1e-9)
        assert field_T[:2].abs().max() < 1e-15


def test_noise_is_that_of_the_truth_in_every_component(small_rig, small_plan):
    clean = simulate(small_rig, small_plan, {"hall.noise_T": 0.0}, seed=0).field_sensor_T
    noise = torch.stack(
        [
            simulate(small_rig, small_plan, {"hall.noise_T": 7e-6}, seed=seed).field_sensor_T - clean
            for seed in range(60)
        ]
    )
    sd_of_sd = 1 / np.sqrt(2 * noise.numel() / 3)
    assert noise.std(dim=(0, 1)).tolist() == pytest.approx([7e-6] * 3, rel=5 * sd_of_sd)
    assert noise.mean().abs() < 5 * 7e-6 / np.sqrt(noise.numel())
    correlation = np.corrcoef(noise.reshape(-1, 3).numpy().T)
    assert np.abs(correlation - np.eye(3)).max() < 5 / np.sqrt(noise.numel() / 3)


def test_each_sensor_has_its_own_noise(small_plan, rig_text):
    rig = rig_from_text(rig_text + "  second: {noise_mT: 1}\n")
    o = simulate(rig, small_plan, {}, seed=0)
    scatter = o.field_sensor_T - perfect_readings(rig, o)
    assert scatter[o.sensor == 0].std().item() == pytest.approx(5e-6, rel=0.25)
    assert scatter[o.sensor == 1].std().item() == pytest.approx(1e-3, rel=0.25)


def test_the_seed_decides_everything_and_nothing_else_does(small_rig, small_plan):
    first, again, differing = (simulate(small_rig, small_plan, {}, seed).field_sensor_T for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.isclose(first, differing, rtol=0, atol=1e-9).any(dim=1).all()


def test_a_repeated_setting_has_the_same_field_and_other_noise(small_rig, small_plan):
    twice = replace(small_plan, repeats=2)
    clean, noisy = (simulate(small_rig, twice, {"hall.noise_T": noise_T}, seed=0) for noise_T in (0.0, 5e-6))
    is_first = clean.repeat == 0
    assert torch.equal(clean.field_sensor_T[is_first], clean.field_sensor_T[~is_first])
    assert not (noisy.field_sensor_T[is_first] == noisy.field_sensor_T[~is_first]).any()


def test_truths_follow_the_priors(small_rig):
    truths = [draw_truth(small_rig, seed) for seed in range(400)]
    assert truths[7] == draw_truth(small_rig, 7)
    assert set(truths[0]) == {parameter.name for parameter in small_rig.free}
    loops = np.array([truth["coil1.axial_loops"] for truth in truths])
    assert (loops == np.round(loops)).all()
    assert loops.mean() == pytest.approx(12, abs=5 * 1.0 / 20)
    radius = np.array([truth["coil1.radius_m"] for truth in truths])
    assert radius.mean() == pytest.approx(0.051, abs=5 * 0.001 / 20)
    assert radius.std() == pytest.approx(0.001, rel=5 / np.sqrt(800))


def test_a_truth_never_lacks_its_bore_nor_a_loop(rig_text):
    wide = rig_text.replace("mean: 51, sd: 1", "mean: 51, sd: 40").replace(
        "mean: 12, sd: 1, lower: 1", "mean: 1, sd: 9"
    )
    rig = rig_from_text(wide)
    for seed in range(200):
        truth = draw_truth(rig, seed)
        assert truth["coil1.radius_m"] > 3 * 2 * 0.00098
        assert truth["coil1.axial_loops"] >= 1.0


def test_priors_that_leave_no_bore_are_refused(rig_text):
    prior = "radius_mm: {value: 51, prior: {normal: {mean: 3, sd: 0.1}}}"
    rig = rig_from_text(rig_text.replace("radius_mm: {prior: {normal: {mean: 51, sd: 1}}}", prior))
    with pytest.raises(InvalidInput, match="priors of rig 'small' must allow windings that leave a bore"):
        draw_truth(rig, 0)


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        (
            {"coil1.radius": 0.05},
            "rig 'small' has no parameter 'coil1.radius'; the closest is coil1.radius_m",
        ),
        (
            {"coil1.axial_pitch_m": 0.002},
            "coil1.axial_pitch_m is tied to coil1.wire_radius_m in rig 'small'; set that one",
        ),
        ({"coil1.radius_m": -0.05}, "truth: coil1.radius_m must be > 0; received -0.05 m (rig 'small')"),
        ({"coil1.wire_radius_m": 0.0}, "truth: coil1.wire_radius_m must be > 0; received 0 m (rig 'small')"),
        ({"coil1.axial_loops": 0.0}, "truth: coil1.axial_loops must be at least 1; received 0 (rig 'small')"),
        ({"hall.noise_T": float("nan")}, "truth: hall.noise_T must be finite; received nan (rig 'small')"),
        ({"hall.noise_T": -1e-6}, "truth: hall.noise_T must be > 0; received -1e-06 T (rig 'small')"),
        (
            {"coil1.radial_loops": 30.0},
            "truth: coil1.radius_m must exceed radial_pitch x radial_loops = 58.8 mm (no bore is left); "
            "received 51 mm (rig 'small')",
        ),
    ],
)
def test_an_impossible_truth_is_refused(small_rig, small_plan, truth, message):
    with pytest.raises(InvalidInput) as caught:
        simulate(small_rig, small_plan, truth, seed=0)
    assert str(caught.value) == message

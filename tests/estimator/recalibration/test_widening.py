"""The widened prior: as wide as what others leave open of a number and what may have changed, round-trip through the rig file."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimator.calibration.result import Calibration
from estimator.recalibration import policy
from estimator.recalibration.widening import widened_rig
from estimator.rig.parameters import LogNormal, Normal
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text

RADIUS, LOOPS_OF_COIL, HEIGHT = "coil1.radius_m", "coil1.axial_loops", "coil1.world_from_coil0.z_m"


def known(calibration: Calibration, rig: Rig, **mean_and_sd: tuple[float, float]) -> Calibration:
    """A calibration of a rig whose free parameters have independent draws of given mean and sd; others are certain."""
    rng = np.random.default_rng(1)
    best = {p.name: p.value for p in rig.free}
    draws = {}
    for p in rig.free:
        mean, sd = mean_and_sd.get(p.name.rpartition(".")[2], (p.value, 0.0))
        best[p.name] = mean
        noise = rng.normal(size=(50, 80))
        draws[p.name] = mean + sd * (noise - noise.mean()) / noise.std()
    return Calibration(rig, calibration.observations, best, draws, calibration.log_prob, {})


def test_a_pose_may_be_another_one_and_a_winding_may_not(small_calibration, small_rig):
    widened = widened_rig(small_calibration, small_rig)
    draws, best = small_calibration.draws, small_calibration.best
    assert draws[LOOPS_OF_COIL].std() == 0.0  # known for sure here, so that they leave the radius as it is
    first = small_rig.parameters[HEIGHT].prior
    assert first is not None
    wanted = {
        RADIUS: math.hypot(draws[RADIUS].std(), policy.EXPANSION * best[RADIUS]),
        LOOPS_OF_COIL: policy.LOOPS,
        HEIGHT: math.hypot(draws[HEIGHT].std(), first.sd),
    }
    for name, sd in wanted.items():
        prior = widened.parameters[name].prior
        assert isinstance(prior, Normal)
        assert prior.mean == pytest.approx(best[name], rel=1e-12)
        assert prior.sd == pytest.approx(sd, rel=1e-5)


def test_what_two_numbers_determine_together_stays_known(small_calibration, small_rig):
    """A posterior that knows radius x loops to 1e-4, and each of them to 1 % only: the prior may not know the product to 1 % only."""
    rng = np.random.default_rng(2)
    relative, product = 0.01 * rng.normal(size=(50, 80)), 1e-4 * rng.normal(size=(50, 80))
    best = dict(small_calibration.best)
    draws = {
        **small_calibration.draws,
        RADIUS: best[RADIUS] * (1.0 + relative),
        LOOPS_OF_COIL: best[LOOPS_OF_COIL] * (1.0 + product - relative),
    }
    calibration = Calibration(
        small_rig, small_calibration.observations, best, draws, small_calibration.log_prob, {}
    )
    widened = widened_rig(calibration, small_rig)
    relative_sd = [widened.parameters[name].prior.sd / best[name] for name in (RADIUS, LOOPS_OF_COIL)]  # type: ignore[union-attr]
    may_change = math.hypot(policy.EXPANSION, policy.LOOPS / best[LOOPS_OF_COIL])
    assert math.hypot(*relative_sd) < math.hypot(may_change, 2e-4)


def test_nothing_else_of_the_rig_changes_and_its_text_says_all(small_calibration, small_rig):
    widened = widened_rig(small_calibration, small_rig)
    assert [p.name for p in widened.free] == [p.name for p in small_rig.free]
    fixed = {n: p for n, p in small_rig.parameters.items() if not p.is_free}
    assert {n: widened.parameters[n] for n in fixed} == fixed
    assert widened.parameters["coil1.axial_loops"].prior.lower == 1.0  # type: ignore[union-attr]
    assert rig_from_text(rig_text(widened)).hash == widened.hash


def test_a_cause_that_began_may_go_on_and_noise_may_age(small_calibration, rig_text):
    text = rig_text.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}")
    text += "effects:\n  axis_gain[hall]: {x: {value: 0.01, prior: {normal: {mean: 0, sd: 0.02}}}, y: 0.0, z: 0.0}\n"
    rig = rig_from_text(text)
    widened = widened_rig(known(small_calibration, rig, x=(0.012, 0.001), noise_T=(6e-6, 3e-7)), rig)
    gain, noise = widened.parameters["axis_gain[hall].x"].prior, widened.parameters["hall.noise_T"].prior
    assert isinstance(gain, Normal)
    assert gain.mean == 0.012
    assert gain.sd == pytest.approx(math.hypot(1e-3, 0.02), rel=1e-2)
    assert isinstance(noise, LogNormal)
    assert noise.relative_sd == pytest.approx(math.hypot(0.05, policy.SHARE_OF_AGEING * 0.5), rel=1e-2)


def test_what_anchors_share_becomes_each_sensor_s_own(small_calibration, rig_text):
    shared = "hall: &probe {noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}}\n  other: *probe"
    rig = rig_from_text(rig_text.replace("hall:\n    noise_uT: 5", shared))
    calibration = known(small_calibration, rig)
    best = {**calibration.best, "hall.noise_T": 6e-6, "other.noise_T": 7e-6}
    widened = widened_rig(
        Calibration(rig, calibration.observations, best, calibration.draws, calibration.log_prob, {}), rig
    )
    values = [widened.parameters[f"{name}.noise_T"].value for name in ("hall", "other")]
    assert values == pytest.approx([6e-6, 7e-6])

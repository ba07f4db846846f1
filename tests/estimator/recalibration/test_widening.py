"""The widened prior: as wide as what others leave open of a number and what may have changed, round-trip through the rig file."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.recalibration import policy
from estimator.recalibration.widening import widened_rig
from estimator.rig.coordinates import Coordinates
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
        assert abs(prior.mean - best[name]) < 0.3 * sd  # the mean of the draws, not their maximum
        assert prior.sd == pytest.approx(sd, rel=2e-3)


def test_what_two_numbers_determine_together_stays_known(small_calibration, small_rig):
    """A posterior knows radius x loops to 1e-4, and each of them to 1 % only: the prior may know neither better nor the product worse."""
    rng = np.random.default_rng(2)
    relative, product = 0.01 * rng.normal(size=(50, 80)), 1e-4 * rng.normal(size=(50, 80))
    best = dict(small_calibration.best)
    draws = {
        **{name: np.full((50, 80), value) for name, value in best.items()},
        RADIUS: best[RADIUS] * np.exp(relative),
        LOOPS_OF_COIL: best[LOOPS_OF_COIL] * np.exp(product - relative),
    }
    calibration = Calibration(
        small_rig, small_calibration.observations, best, draws, small_calibration.log_prob, {}
    )
    joint = widened_rig(calibration, small_rig).joint
    assert joint is not None
    index = [joint.names.index(name) for name in (RADIUS, LOOPS_OF_COIL)]
    variance = np.array(joint.covariance)[np.ix_(index, index)]
    to_logarithm = np.array([1.0 / best[RADIUS], 1.0])  # the coordinates are a rms radius and a logarithm
    may_change = math.hypot(policy.EXPANSION, policy.LOOPS / best[LOOPS_OF_COIL])
    for weights, sd in (([1.0, 0.0], 0.01), ([0.0, 1.0], 0.01), ([1.0, 1.0], may_change)):
        along = to_logarithm * weights
        assert math.sqrt(along @ variance @ along) == pytest.approx(sd, rel=0.05)


def test_a_prior_together_is_the_normal_law_that_it_states(small_calibration, small_rig):
    widened = widened_rig(small_calibration, small_rig)
    joint, coordinates = widened.joint, Coordinates(widened)
    assert joint is not None
    assert joint.names == coordinates.names
    step = (
        torch.linalg.cholesky(torch.tensor(joint.covariance, dtype=torch.float64))
        @ torch.tensor([1.0, -2.0, 0.5]).double()
    )
    values = {name: float(v) for name, v in coordinates.values(coordinates.start()).items()}
    there = coordinates.unmixed(values) + step
    assert not coordinates.integer_counts
    moved = coordinates.log_prior(there) - coordinates.log_prior(coordinates.start())
    assert float(moved) == pytest.approx(-0.5 * sum(x * x for x in (1.0, -2.0, 0.5)), rel=1e-9)


def test_draws_of_a_prior_together_have_its_covariance(small_calibration, small_rig):
    widened = widened_rig(small_calibration, small_rig)
    coordinates = Coordinates(widened)
    draws = coordinates.sample_prior(np.random.default_rng(4), 4000)
    assert widened.joint is not None
    for name in (RADIUS, HEIGHT):
        i = widened.joint.names.index(name)
        assert float(draws[:, i].std()) == pytest.approx(math.sqrt(widened.joint.covariance[i][i]), rel=0.06)


@pytest.mark.parametrize(
    ("names", "rows", "rule"),
    [
        (["coil1.radius"], [[1.0]], "of must list free numbers"),
        (["coil1.radius_m"] * 2, [[1.0, 0.0], [0.0, 1.0]], "of must list free numbers"),
        (["coil1.radius_m"], [[-1.0]], "must be 1 rows of a symmetric, positive definite matrix"),
        (["coil1.radius_m"], [1.0, 2.0], "must be 1 rows"),
    ],
)
def test_a_wrong_prior_together_is_refused(small_rig, names, rows, rule):
    text = rig_text(small_rig) + f"joint_prior: {{of: {names}, covariance: {rows}}}\n"
    with pytest.raises(InvalidInput, match=rule):
        rig_from_text(text)


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
    noises = {"hall.noise_T": np.full((50, 80), 6e-6), "other.noise_T": np.full((50, 80), 7e-6)}
    widened = widened_rig(replace(calibration, draws={**calibration.draws, **noises}), rig)
    values = [widened.parameters[f"{name}.noise_T"].value for name in ("hall", "other")]
    assert values == pytest.approx([6e-6, 7e-6])

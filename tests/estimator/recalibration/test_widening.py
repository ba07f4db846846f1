"""The widened prior: centred where the posterior was, wide where something may be mounted anew, round-trip through the rig file."""

from __future__ import annotations

import math

import pytest

from estimator.calibration import Calibration
from estimator.config import rig_from_text
from estimator.parameters import LogNormal, Normal
from estimator.recalibration.widening import POSTERIOR_SDS, SHARE, SHARE_OF_POSE, widened_rig
from estimator.rig import Rig


@pytest.mark.parametrize(
    ("name", "share"), [("coil1.radius_m", SHARE), ("coil1.world_from_coil0.z_m", SHARE_OF_POSE)]
)
def test_prior_is_the_posterior_widened_by_a_share_of_the_first_prior(
    small_calibration: Calibration, small_rig: Rig, name: str, share: float
) -> None:
    own, first = small_calibration.record["parameters"][name], small_rig.parameters[name].prior
    assert first is not None
    prior = widened_rig(small_calibration, small_rig).parameters[name].prior
    assert isinstance(prior, Normal)
    assert prior.mean == pytest.approx(own["median"], rel=1e-12)
    assert prior.sd == pytest.approx(math.hypot(POSTERIOR_SDS * own["sd"], share * first.sd), rel=1e-12)


def test_nothing_else_of_the_rig_changes_and_its_text_says_all(
    small_calibration: Calibration, small_rig: Rig
) -> None:
    widened = widened_rig(small_calibration, small_rig)
    assert [p.name for p in widened.free] == [p.name for p in small_rig.free]
    fixed = {n: p for n, p in small_rig.parameters.items() if not p.is_free}
    assert {n: widened.parameters[n] for n in fixed} == fixed
    assert widened.parameters["coil1.axial_loops"].prior.lower == 1.0  # type: ignore[union-attr]
    assert rig_from_text(widened.text).hash == widened.hash


def test_quantities_of_causes_and_noise_are_widened_too(
    small_calibration: Calibration, rig_text: str
) -> None:
    text = rig_text.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}")
    text += "effects:\n  axis_gain[hall]: {x: {value: 0.01, prior: {normal: {mean: 0, sd: 0.02}}}, y: 0.0, z: 0.0}\n"
    rig = rig_from_text(text)
    record = {p.name: {"median": p.value, "sd": 0.0} for p in rig.free}
    record["axis_gain[hall].x"] = {"median": 0.012, "sd": 0.001}
    record["hall.noise_T"] = {"median": 6e-6, "sd": 3e-7}
    known = Calibration(
        rig, small_calibration.observations, {}, {}, small_calibration.log_prob, {"parameters": record}
    )
    widened = widened_rig(known, rig)
    gain, noise = widened.parameters["axis_gain[hall].x"].prior, widened.parameters["hall.noise_T"].prior
    assert isinstance(gain, Normal)
    assert (gain.mean, gain.sd) == pytest.approx((0.012, math.hypot(POSTERIOR_SDS * 1e-3, SHARE * 0.02)))
    assert isinstance(noise, LogNormal)
    assert noise.relative_sd == pytest.approx(math.hypot(POSTERIOR_SDS * 0.05, SHARE * 0.5))


def test_what_anchors_share_becomes_each_sensor_s_own(small_calibration: Calibration, rig_text: str) -> None:
    shared = "hall: &probe {noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}}\n  other: *probe"
    rig = rig_from_text(rig_text.replace("hall:\n    noise_uT: 5", shared))
    record = {p.name: {"median": p.value, "sd": 0.0} for p in rig.free}
    record["hall.noise_T"], record["other.noise_T"] = {"median": 6e-6, "sd": 0.0}, {"median": 7e-6, "sd": 0.0}
    known = Calibration(
        rig, small_calibration.observations, {}, {}, small_calibration.log_prob, {"parameters": record}
    )
    widened = widened_rig(known, rig)
    values = [widened.parameters[f"{name}.noise_T"].value for name in ("hall", "other")]
    assert values == pytest.approx([6e-6, 7e-6])

"""A calibration says first whether it can be used: good, suspect or unusable, why, and what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from estimator.calibration.calibrate import calibrate
from estimator.calibration.quality import condition, tensions
from estimator.calibration.report import calibration_report
from estimator.calibration.residual_groups import residual_groups
from estimator.calibration.summary import _prior_tension
from estimator.cli.main import main
from estimator.inference.ensemble import SamplerSettings
from estimator.inference.noise_of_readings import noise_of_readings_T
from estimator.live.picture import places
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.estimator.conftest import RIG

pytestmark = pytest.mark.whole

QUICK = SamplerSettings(n_walkers=16, target_ess=50.0, largest_rhat=1.5)
FREE_NOISE = RIG.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}")


def quality(session: Session) -> dict[str, object]:
    verdict = calibrate(session, settings=QUICK, seed=1).summary()["quality"]
    assert isinstance(verdict, dict)
    return verdict


def shifted(rig: Rig, plan: Plan, truth: dict[str, float], shift_m: float) -> Session:
    """The sensor is somewhere else than the rig file says."""
    readings = simulate(rig, plan, {**truth, "hall.world_from_sensor.x_m": shift_m}, seed=1)
    return Session(rig, readings, "shifted")


def test_a_session_of_its_own_rig_is_good(small_calibration):
    verdict = small_calibration.summary()["quality"]
    assert verdict["verdict"] == "good"
    assert "8.66 µT" in verdict["reasons"][0]  # sqrt(3) times 5 uT
    assert "Good: it misses" in calibration_report(small_calibration, "test")


def test_what_has_not_converged_is_not_good(small_session):
    few = SamplerSettings(16, target_ess=1e6, largest_rhat=1.0001, max_steps=60)
    quality = calibrate(small_session, settings=few, seed=1).summary()["quality"]
    assert quality["verdict"] == "suspect"
    assert quality["reasons"] == ["sampling did not converge, so its intervals are provisional."]


def test_a_wrong_sign_of_the_current_is_unusable_and_has_its_exit_code(small_session, tmp_path):
    readings = small_session.observations
    turned = replace(small_session, observations=readings.with_field(-readings.field_sensor_T))
    turned.save(tmp_path / "turned.zarr")
    arguments = [
        "calibrate",
        str(tmp_path / "turned.zarr"),
        "--out",
        str(tmp_path / "out"),
        "--walkers",
        "16",
        "--ess",
        "50",
        "--max-steps",
        "100",
    ]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 6
    assert result.stdout.startswith("unusable: the model misses ")
    assert "coilcal diagnose" in result.stdout.splitlines()[1]
    assert (tmp_path / "out/summary.json").exists()


def test_gauss_called_millitesla_that_draw_the_winding_around_the_sensor_are_unusable(small_session):
    readings = small_session.observations
    tenfold = replace(small_session, observations=readings.with_field(10.0 * readings.field_sensor_T))
    assert quality(tenfold)["verdict"] == "unusable"


def test_a_wrong_place_of_the_sensor_is_suspect_by_what_the_noise_leaves(small_rig, small_plan, small_truth):
    verdict = quality(shifted(small_rig, small_plan, small_truth, 2e-3))
    assert verdict["verdict"] == "suspect"
    assert "times what the expected noise leaves" in str(verdict["reasons"])


def test_noise_that_swallows_the_error_is_suspect_itself(small_plan, small_truth):
    rig = rig_from_text(FREE_NOISE)
    truth = {**small_truth, "hall.noise_T": 5e-6}
    assert quality(shifted(rig, small_plan, truth, 0.0))["verdict"] == "good"
    verdict = quality(shifted(rig, small_plan, truth, 8e-3))
    assert verdict["verdict"] == "suspect"
    assert "times what the expected noise leaves" in str(verdict["reasons"])


def test_a_slipped_decimal_point_among_fitted_readings_is_told(small_plan, small_truth):
    """A free noise grows until the halves agree: the error of what was fitted tells, and which reading has it."""
    rig = rig_from_text(FREE_NOISE)
    readings = simulate(rig, small_plan, {**small_truth, "hall.noise_T": 5e-6}, seed=1)
    field_T = readings.field_sensor_T.clone()
    strongest = int(field_T[:, 2].abs().masked_fill(readings.is_validation, 0.0).argmax())
    field_T[strongest, 2] *= 10.0
    slipped = replace(readings.with_field(field_T), line=torch.arange(len(readings)) + 2)
    verdict = quality(Session(rig, slipped, "slipped"))
    assert verdict["verdict"] == "suspect"
    told = str(verdict["reasons"])
    assert "times what the expected noise leaves" in told
    assert f"is that of a single one (line {strongest + 2})" in told


def test_noise_that_the_rig_file_says_to_grow_with_the_field_is_expected(small_plan, small_truth):
    """A twentieth of some tenths of a millitesla beside 5 uT: the error is what such noise leaves, and groups of residuals are about 1."""
    rig = rig_from_text(f"{RIG}effects:\n  noise_grows[hall]: {{share: 0.05}}\n")
    calibration = calibrate(
        Session(rig, simulate(rig, small_plan, small_truth, seed=1), "growing"), settings=QUICK, seed=1
    )
    readings = calibration.observations
    own_T = noise_of_readings_T(rig, readings, calibration.best)
    clear = readings.field_sensor_T.abs() > 2e-4
    expected_T = (5e-6**2 + (0.05 * readings.field_sensor_T[clear]) ** 2).sqrt()
    torch.testing.assert_close(own_T[clear], expected_T, rtol=0.15, atol=0.0)  # the nominal field
    assert float(own_T[clear].min()) > 1.5 * 5e-6
    assert calibration.summary()["quality"]["verdict"] == "good"
    assert all(0.6 < group.rms_sigma < 1.4 for group in residual_groups(calibration))
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in calibration.best.items()}
    shown = places(rig, values, readings, range(len(readings)))
    assert float(np.mean([place.rms_sigma**2 for place in shown])) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(("factor", "told"), [(4.0, ["hall.noise_T"]), (0.25, [])])
def test_a_noise_is_far_from_its_prior_where_it_is_too_large(factor, told):
    rig = rig_from_text(
        RIG.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 10, relative_sd: 0.5}}}")
    )
    draws = {name: np.full((1, 2), value) for name, value in rig.nominal_values().items()}
    assert list(_prior_tension(rig, draws | {"hall.noise_T": np.full((1, 2), factor * 1e-5)})) == told
    sentences = tensions(rig.free, rig.nominal_values() | {"hall.noise_T": factor * 1e-5})
    assert sentences == (["noise is 40 µT where 10 is expected, 4 times as much."] if told else [])


def test_a_number_far_from_its_prior_is_suspect(small_plan, small_truth):
    rig = rig_from_text(RIG)
    truth = {**small_truth, "coil1.world_from_coil0.z_m": -0.054}
    verdict = quality(Session(rig, simulate(rig, small_plan, truth, seed=1), "far"))
    assert verdict["verdict"] == "suspect"
    assert "hold only if nothing is" in str(verdict["next"])
    assert condition(verdict) == " if nothing is wrong"
    assert condition({"verdict": "good"}) == ""
    assert "z is -5" in str(verdict["reasons"])
    assert "widths of its prior" in str(verdict["reasons"])

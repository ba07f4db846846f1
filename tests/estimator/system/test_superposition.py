"""Separately calibrated coils with all on: coupling is found where it is, and bounded where it is not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.effects.attach import with_effect
from estimator.errors import InvalidInput
from estimator.model.simulate import simulate
from estimator.readings.plan import load_plan
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from estimator.system.superposition import Superposition, joined, predicted_readings_T, superposition
from estimator.system.system import System

RIG = """
schema_version: 1
name: two coils on two arms
movers:
  arm1: {motion: displacement}
  arm2: {motion: displacement}
coils:
  coil1:
    carried_by: arm1
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: 0.98
    axial_loops: 12
    radial_loops: 5
    current_gain: {prior: {normal: {mean: 1, sd: 0.005}}}
    world_from_coil0: {z_mm: {prior: {normal: {mean: -60, sd: 2}}}}
  coil2:
    carried_by: arm2
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: 0.98
    axial_loops: 12
    radial_loops: 5
    current_gain: {prior: {normal: {mean: 1, sd: 0.005}}}
    world_from_coil0: {x_mm: {prior: {normal: {mean: 70, sd: 2}}}, ry_deg: -90}
sensors:
  hall: {noise_uT: 5}
"""
PLAN = """
schema_version: 1
name: scattered
poses:
  calibration:
    scattered: 24
    arm1: {x_mm: {from: -20, to: 20}, y_mm: {from: -20, to: 20}, z_mm: {from: -20, to: 10}}
    arm2: {x_mm: {from: -20, to: 20}, y_mm: {from: -20, to: 20}, z_mm: {from: -20, to: 10}}
currents_A: [%s]
"""
TRUTH = {"coil1.radius_m": 0.0515, "coil2.radius_m": 0.0505, "coil1.world_from_coil0.z_m": -0.0612}


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(RIG)


def measured(rig: Rig, folder: object, currents: str, seed: int, hidden: dict[str, float]) -> Session:
    path = folder / "plan.yaml"  # type: ignore[operator]
    path.write_text(PLAN % currents, encoding="utf-8")
    return Session(rig, simulate(rig, load_plan(path, rig), TRUTH, seed, hidden), "simulated", truth=TRUTH)


def calibrated(session: Session) -> Calibration:
    """A calibration at the truth."""
    best = session.rig.with_values(TRUTH).nominal_values()
    draws = {p.name: np.full((2, 3), best[p.name]) for p in session.rig.free}
    return Calibration(session.rig, session.observations, best, draws, np.zeros((2, 3)), {})


def visited(rig: Rig, folder: object, hidden: dict[str, float]) -> tuple[System, Session]:
    alone = [measured(rig, folder, f"{{coil{i}: 3}}", i, hidden) for i in (1, 2)]
    both = measured(rig, folder, "{coil1: 3, coil2: 3}, {coil1: 3, coil2: -3}", 3, hidden)
    return System.of(*map(calibrated, alone)), both


@pytest.fixture(scope="module")
def clean(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Superposition:
    return superposition(*visited(rig, tmp_path_factory.mktemp("clean"), {}), seed=1)


@pytest.fixture(scope="module")
def coupled(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Superposition:
    hidden = {"neighbour_coil[coil2].share": 0.02}
    return superposition(*visited(rig, tmp_path_factory.mktemp("coupled"), hidden), seed=1)


def test_coils_that_add_up_are_not_said_to_couple_and_the_share_is_bounded(clean):
    assert not clean.is_coupled
    assert clean.errors.vector_T == pytest.approx(5e-6 * 3**0.5, rel=0.15)
    for share in clean.shares.values():
        assert abs(share.share) < 3.5 * share.sd
        assert share.largest < 0.01
        assert share.most_T < 30e-6
    assert clean.words().startswith("no coupling found: coil1 carries ")


def test_a_coil_that_carries_a_share_of_its_neighbour_is_named_and_the_share_is_found(clean, coupled):
    assert coupled.is_coupled
    assert [named.cause.label for named in coupled.diagnosis.causes] == ["neighbour_coil[coil2]"]
    assert abs(coupled.shares["coil2"].share - 0.02) < 3.5 * coupled.shares["coil2"].sd
    assert abs(coupled.shares["coil1"].share) < 3.5 * coupled.shares["coil1"].sd
    assert coupled.errors.vector_T > 1.1 * clean.errors.vector_T
    assert coupled.words().startswith("coils couple")


def test_the_plain_sum_predicts_what_perfect_sensors_read(rig, tmp_path):
    session = measured(rig.with_values({"hall.noise_T": 0.0}), tmp_path, "{coil1: 3, coil2: -2}", 4, {})
    alone = [measured(rig, tmp_path, f"{{coil{i}: 3}}", i, {}) for i in (1, 2)]
    predicted_T = predicted_readings_T(System.of(*map(calibrated, alone)), session, session.observations)
    torch.testing.assert_close(predicted_T, session.observations.field_sensor_T, rtol=1e-5, atol=1e-10)


def test_the_zero_of_a_sensor_that_calibrations_know_is_no_error_of_the_sum(rig, tmp_path):
    zero = {"sensor_offset[hall].x_T": 60e-6, "sensor_offset[hall].z_T": -40e-6}
    session = measured(rig.with_values({"hall.noise_T": 0.0}), tmp_path, "{coil1: 3, coil2: -2}", 4, zero)
    with_zero = with_effect(rig, Cause("sensor_offset", "hall"), session.observations, {}).with_values(zero)
    alone = [calibrated(measured(with_zero, tmp_path, f"{{coil{i}: 3}}", i, {})) for i in (1, 2)]
    predicted_T = predicted_readings_T(System.of(*alone), session, session.observations)
    torch.testing.assert_close(predicted_T, session.observations.field_sensor_T, rtol=1e-5, atol=1e-10)


def test_joined_sessions_follow_each_other_in_time(rig, tmp_path):
    first, second = (measured(rig, tmp_path, "{coil1: 3}", seed, {}).observations for seed in (1, 2))
    both = joined([first, second])
    assert len(both) == len(first) + len(second)
    assert both.time_s[: len(first)].max() < both.time_s[len(first) :].min()
    assert torch.equal(both.motion["arm2"][len(first) :], second.motion["arm2"])


def test_readings_with_one_coil_on_cannot_test_superposition(rig, tmp_path):
    alone = measured(rig, tmp_path, "{coil1: 3}", 1, {})
    with pytest.raises(InvalidInput, match="two coils on at once"):
        superposition(System.of(calibrated(alone)), alone)


def test_a_calibration_of_another_rig_is_refused(rig, tmp_path):
    renamed = rig_from_text(RIG.replace("hall", "probe"))
    both = measured(rig, tmp_path, "{coil1: 3, coil2: 3}", 1, {})
    with pytest.raises(InvalidInput, match="sensors of the rig must be those of the session"):
        superposition(System.of(calibrated(measured(renamed, tmp_path, "{coil1: 3}", 1, {}))), both)

"""`coilcal design` as a user calls it, and `coilcal simulate --hide`."""

from __future__ import annotations

import json

import pytest

from estimator.store.session import load_session
from tests.estimator.cli.conftest import refused, run

TWINS = ("--split", "background_field", "--split", "sensor_offset")


def test_a_turned_sensor_is_proposed_to_split_twins(workspace):
    result = run("design", workspace / "session.zarr", *TWINS, "--readings", 3, "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    best = found["programmes"][0]
    assert "turned by 90 degrees" in best["action"]
    assert best["expected_log_evidence"] > 3.0 > found["programmes"][-1]["expected_log_evidence"]
    assert len(found["reached"]) == 3
    assert found["plan"] is None


def test_the_plan_can_be_simulated(workspace, tmp_path):
    plan = tmp_path / "plan.yaml"
    result = run(
        "design", workspace / "session.zarr", "--shrink", "coil1.radius_m", "--readings", 4, "--out", plan
    )
    assert result.exit_code == 0
    assert str(plan) in result.stdout
    again = run("simulate", "--rig", workspace / "rig.yaml", "--plan", plan, "--out", tmp_path / "more.zarr")
    assert again.exit_code == 0
    assert len(load_session(tmp_path / "more.zarr").observations) == 4


def test_a_map_is_planned(workspace, tmp_path):
    plan = tmp_path / "map.yaml"
    goal = ("--map", "coil_harmonics[coil1]", "--degree", 2, "--readings", 5)
    result = run("design", workspace / "session.zarr", *goal, "--out", plan)
    assert result.exit_code == 0
    assert "T/A" in result.stdout
    again = run("simulate", "--rig", workspace / "rig.yaml", "--plan", plan, "--out", tmp_path / "more.zarr")
    assert again.exit_code == 0


def test_an_existing_plan_is_kept(workspace):
    result = run("design", workspace / "session.zarr", *TWINS, "--out", workspace / "plan.yaml")
    assert "plan.yaml" in refused(result)


def test_a_hidden_cause_is_in_the_truth_by_its_full_name_and_in_the_readings(simulate, tmp_path):
    plain, flawed = tmp_path / "plain.zarr", tmp_path / "flawed.zarr"
    assert simulate("--truth", "nominal", "--out", plain).exit_code == 0
    hidden = ("--hide", "sensor_offset.z_T=1e-4")
    result = simulate("--truth", "nominal", *hidden, "--out", flawed, "--json")
    assert json.loads(result.stdout)["truth"]["sensor_offset[hall].z_T"] == 1e-4
    one, other = (load_session(path) for path in (plain, flawed))
    change_T = other.observations.field_sensor_T - one.observations.field_sensor_T
    assert change_T.mean(0).tolist() == pytest.approx([0.0, 0.0, 1e-4], abs=1e-9)
    assert other.rig.effects == ()


def test_a_hidden_cause_that_does_not_exist_is_refused_before_anything_is_written(simulate, tmp_path):
    result = simulate("--hide", "gain=1", "--out", tmp_path / "a.zarr")
    assert "cause must be one that coilcal knows" in refused(result)
    assert not (tmp_path / "a.zarr").exists()

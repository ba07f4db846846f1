"""A batch over small sessions: every one fitted, a bad one told, nothing done twice, and the same whatever is stacked with what."""

from __future__ import annotations

import html
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import arviz
import numpy as np
import pytest
from distributed import LocalCluster

from estimator import SamplerSettings
from estimator.batching import batch
from estimator.batching.jobs import PLAIN, jobs_of, stacks
from estimator.batching.page import _scalars, _verdict, overview
from estimator.batching.result import BatchResult, most_probable
from estimator.batching.work import fit, is_enough
from estimator.errors import InvalidInput
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan, load_plan
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.estimator.conftest import RIG, SIDEWAYS, TWO_COILS

HYPOTHESES = ("plain", "axis_gain")


@pytest.fixture(scope="module")
def sessions(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float], tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("sessions")
    paths = [folder / f"day{i}.zarr" for i in range(3)]
    for i, path in enumerate(paths):
        Session(small_rig, simulate(small_rig, small_plan, small_truth, seed=i), f"day {i}").save(path)
    return paths


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as local:
        yield local.scheduler_address


@pytest.fixture(scope="module")
def fitted(sessions: list[Path], address: str, tmp_path_factory) -> BatchResult:
    out = tmp_path_factory.mktemp("batch")
    bad = out / "bad.zarr"
    bad.mkdir()
    return batch([*sessions, bad], out=out, hypotheses=HYPOTHESES, has_posterior=False, scheduler=address)


def test_all_sessions_are_fitted_under_all_hypotheses_and_the_bad_one_is_told(fitted, sessions):
    table = fitted.table()
    assert len(table) == 6
    assert set(table["session"]) == {str(path) for path in sessions}
    assert next(iter(fitted.failed.values())).startswith("session must be a folder that coilcal import")
    assert table.groupby("session")["probability"].sum().to_numpy() == pytest.approx(np.ones(3))
    assert table["is_converged"].any()


def test_clean_sessions_prefer_the_plain_rig(fitted):
    table = fitted.table()
    assert (table[table["hypothesis"] == "plain"]["probability"] > 0.5).all()


def test_a_correction_of_the_rig_is_fitted_in_each_session(
    corrected_rig, small_plan, small_truth, address, tmp_path
):
    sizes_T_per_A = (5e-6, 25e-6)
    for i, size in enumerate(sizes_T_per_A):
        readings = simulate(corrected_rig, small_plan, {**small_truth, SIDEWAYS: size}, seed=i)
        Session(corrected_rig, readings, f"day {i}").save(tmp_path / f"day{i}.zarr")
    paths = [tmp_path / f"day{i}.zarr" for i in range(2)]
    table = batch(paths, out=tmp_path / "out", has_posterior=False, scheduler=address).table()
    assert table[SIDEWAYS].to_numpy() == pytest.approx(np.array(sizes_T_per_A), abs=1.5e-6)


def test_what_no_laboratory_is_without_is_fitted_in_every_hypothesis_unless_as_described(
    small_rig, small_plan, small_truth, address, tmp_path
):
    """As `coilcal calibrate` does, so that a fit and the posterior of its job are of one model; such sessions are stacked all the same."""
    rig = rig_from_text(RIG + "effects:\n  background_field[room]: {x_T: 0, y_T: 0, z_T: -43.0e-6}\n")
    plan = replace(small_plan, currents_A=({"coil1": 0.0}, {"coil1": 3.0}))
    paths = [tmp_path / f"day{i}.zarr" for i in range(2)]
    for i, path in enumerate(paths):
        readings = simulate(rig, plan, small_truth, seed=i)
        later = replace(readings, time_s=readings.time_s + 1000.0 * i)
        Session(small_rig, later, f"day {i}").save(path)
    jobs = [job for path in paths for job in jobs_of(str(path), None, ("plain",), False, 0)[0]]
    assert len({job.settings for job in jobs}) == 1

    def fitted_as(as_described: bool) -> BatchResult:
        out = tmp_path / f"out{as_described}"
        hypotheses = ("plain", "sensor_offset")
        return batch(
            paths,
            out=out,
            hypotheses=hypotheses,
            has_posterior=False,
            scheduler=address,
            as_described=as_described,
        )

    besides, alone = fitted_as(False), fitted_as(True)
    z_T = besides.table()[["background_field[room].z_T", "sensor_offset[hall].z_T"]].sum(axis=1)
    assert z_T.to_numpy() == pytest.approx(-43e-6, abs=6e-6)
    assert set(besides.table()["hypothesis"]) == {"plain"}
    assert all("is a part of all" in why for why in besides.failed.values())
    assert set(alone.table()["hypothesis"]) == {"plain", "sensor_offset"}
    assert "background_field[room].z_T" not in alone.table()
    assert not alone.failed


def test_leaders_are_sampled_and_their_posterior_is_what_the_table_shows(sessions, address, tmp_path):
    settings = SamplerSettings(n_walkers=16, target_ess=50.0, largest_rhat=1.2)
    result = batch(sessions[:1], out=tmp_path, settings=settings, scheduler=address)
    (row,) = result.table().to_dict("records")
    assert row["is_sampled"]
    assert row["verdict"] == "good"
    draws = result.calibration(row["job"]).draws["coil1.radius_m"]
    assert row["coil1.radius_m"] == pytest.approx(float(np.median(draws)))
    with pytest.raises(InvalidInput, match="must have been sampled"):
        result.calibration("another")
    opened = arviz.InferenceData.from_datatree(result.tree(row["job"]))
    assert opened.posterior["coil1.radius_m"].to_numpy() == pytest.approx(draws)
    assert float(arviz.ess(opened.posterior)["coil1.radius_m"]) > 50.0


def test_a_posterior_goes_on_where_more_is_asked_for_and_ends_as_if_that_had_been_asked_at_once(
    sessions, address, tmp_path
):
    little, more = (
        SamplerSettings(n_walkers=16, target_ess=ess, largest_rhat=1.2, check_every=20)
        for ess in (50.0, 300.0)
    )

    def ask(out: str, settings: SamplerSettings) -> tuple[BatchResult, Path]:
        result = batch(sessions[:1], out=tmp_path / out, settings=settings, scheduler=address)
        return result, result.folder / result.names[0] / "calibration"

    ask("twice", little)
    again, first = ask("twice", more)
    _, second = ask("once", more)
    assert again.n_new == 1
    files = [path.relative_to(first) for path in sorted(first.rglob("*")) if path.is_file()]
    assert all((first / path).read_bytes() == (second / path).read_bytes() for path in files)
    assert ask("twice", little)[0].n_new == 0


def test_other_walkers_are_another_job(sessions):
    names = {
        jobs_of(str(sessions[0]), None, ("plain",), False, 0, SamplerSettings(n_walkers=n, target_ess=ess))[
            0
        ][0].name
        for n, ess in ((16, 100.0), (18, 100.0), (18, 200.0))
    }
    assert len(names) == 2


def test_another_precision_is_another_job_with_nearly_the_same_result(fitted, sessions, tmp_path):
    (plain,), _ = jobs_of(str(sessions[0]), None, ("plain",), False, 0)
    result = batch(sessions[:1], out=tmp_path, precision="single", has_posterior=False, workers=0)
    assert result.names[0] != plain.name
    old, new = (
        json.loads((folder / name / "result.json").read_text())
        for folder, name in ((fitted.folder, plain.name), (result.folder, result.names[0]))
    )
    assert (new["precision"], old["precision"]) == ("single", "double")
    assert new["log_evidence"] == pytest.approx(old["log_evidence"], abs=1e-3)


def test_device_and_precision_that_do_not_exist_are_refused_at_once(sessions, tmp_path):
    with pytest.raises(InvalidInput, match="device must be one that torch can compute on"):
        batch(sessions[:1], out=tmp_path, device="gpu", workers=0)
    with pytest.raises(InvalidInput, match="precision must be one of double, single"):
        batch(sessions[:1], out=tmp_path, precision="half", workers=0)


def test_what_is_enough_depends_on_what_is_asked_for(tmp_path):
    sampling = {"smallest_ess": 150.0, "largest_rhat": 1.005, "steps": 1000}
    (tmp_path / "summary.json").write_text(json.dumps({"sampling": sampling}))
    assert is_enough(tmp_path, SamplerSettings(target_ess=100.0))
    assert not is_enough(tmp_path, SamplerSettings(target_ess=200.0))
    assert not is_enough(tmp_path, SamplerSettings(target_ess=100.0, largest_rhat=1.001))
    assert is_enough(tmp_path, SamplerSettings(target_ess=200.0, max_steps=1000))
    assert not is_enough(tmp_path / "none", SamplerSettings())


def test_only_what_is_missing_of_a_stack_counts_as_new(sessions, address, tmp_path):
    def ask() -> BatchResult:
        return batch(sessions, out=tmp_path, has_posterior=False, scheduler=address)

    first = ask()
    shutil.rmtree(first.folder / first.names[1])
    assert ask().n_new == 1


def test_copies_and_what_is_asked_for_twice_are_fitted_once(sessions, address, tmp_path):
    for folder in ("a", "b"):
        shutil.copytree(sessions[0], tmp_path / folder / "day.zarr")
    shutil.copytree(sessions[1], tmp_path / "c" / "day.zarr")
    told: list[str] = []
    result = batch(
        [tmp_path / folder / "day.zarr" for folder in "abc"],
        out=tmp_path,
        hypotheses=("plain", "plain"),
        has_posterior=False,
        scheduler=address,
        tell=lambda _done, _total, words: told.append(words),
    )
    table = result.table()
    assert (table["probability"].to_numpy() == 1.0).all()
    assert len(table) == 2
    assert any("b/day.zarr holds the readings of" in words for words in told)
    page = overview(result, "")
    assert "a/day" in page
    assert "c/day" in page


def test_a_session_that_was_moved_competes_with_what_was_found_where_it_was(sessions, address, tmp_path):
    def ask(path: Path, *hypotheses: str) -> BatchResult:
        return batch([path], out=tmp_path, hypotheses=hypotheses, has_posterior=False, scheduler=address)

    old, new = tmp_path / "old" / "day.zarr", tmp_path / "new" / "day.zarr"
    shutil.copytree(sessions[0], old)
    ask(old, "plain")
    new.parent.mkdir()
    old.rename(new)
    table = ask(new, "plain", "axis_gain").table()
    assert table["probability"].sum() == pytest.approx(1.0)
    assert set(table["session"]) == {str(new)}


def test_a_hypothesis_that_one_rig_has_not_got_leaves_the_others(sessions, address, tmp_path):
    result = batch(
        sessions[:1],
        out=tmp_path,
        hypotheses=("plain", "mount_tilt[coil7]"),
        has_posterior=False,
        scheduler=address,
    )
    assert len(result.names) == 1
    assert list(result.failed) == [f"{sessions[0]}, mount_tilt[coil7]"]


def test_coils_are_told_apart_in_the_data_set(tmp_path, address):
    rig = rig_from_text(TWO_COILS)
    (tmp_path / "plan.yaml").write_text(
        PLAN.replace("y_mm: 0, z_mm: 0", "y_mm: {from: 0, to: 20, count: 3}, z_mm: 0")
    )
    truth = {name: value for name, value in rig.nominal_values().items() if rig.parameters[name].tie is None}
    observations = simulate(rig, load_plan(tmp_path / "plan.yaml", rig), truth, seed=1)
    Session(rig, observations, "two coils").save(tmp_path / "both.zarr")
    result = batch(
        [tmp_path / "both.zarr"], out=tmp_path, is_each_coil=True, has_posterior=False, scheduler=address
    )
    assert result.dataset()["coil"].to_numpy().tolist() == ["coil1", "coil2"]


def test_truth_lies_within_four_standard_deviations(fitted, small_truth):
    arrays = fitted.dataset()
    plain = arrays.sel(job=arrays["hypothesis"] == "plain")
    for name, value in small_truth.items():
        if name in plain["parameter"]:
            one = plain.sel(parameter=name)
            assert (abs(one["median"] - value) < 4.0 * one["sd"]).all(), name


def test_what_is_finished_is_not_done_again(fitted, sessions, address):
    before = {name: (fitted.folder / name / "result.json").stat().st_mtime_ns for name in fitted.names}
    told: list[str] = []
    again = batch(
        sessions,
        out=fitted.folder.parent,
        hypotheses=HYPOTHESES,
        has_posterior=False,
        scheduler=address,
        tell=lambda done, total, words: told.append(words),
    )
    assert set(told) == {"done before"}
    assert {name: (again.folder / name / "result.json").stat().st_mtime_ns for name in again.names} == before


def test_unfinished_rest_of_a_stack_gets_the_same_numbers(fitted, sessions, tmp_path):
    jobs = [job for path in sessions for job in jobs_of(str(path), None, HYPOTHESES, False, 0)[0]]
    assert {job.name for job in jobs} == set(fitted.names)
    stack = next(iter(stacks(jobs, 8000, 64)))
    assert len(stack) == 3
    (tmp_path / stack[0].name).mkdir()
    (tmp_path / stack[0].name / "result.json").write_text("{}")
    assert fit(stack, str(tmp_path)) == {}
    assert (tmp_path / stack[0].name / "result.json").read_text() == "{}"
    for job in stack[1:]:
        old, new = (
            json.loads((where / job.name / "result.json").read_text()) for where in (fitted.folder, tmp_path)
        )
        assert old == new


def test_a_session_fitted_alone_agrees_with_the_stack(fitted, sessions, tmp_path):
    (job,), _ = jobs_of(str(sessions[1]), None, ("plain",), False, 0)
    fit([job], str(tmp_path))
    old, new = (
        json.loads((where / job.name / "result.json").read_text()) for where in (fitted.folder, tmp_path)
    )
    assert new["log_evidence"] == pytest.approx(old["log_evidence"], abs=1e-3)
    for name, p in new["parameters"].items():
        assert abs(p["median"] - old["parameters"][name]["median"]) < 0.02 * p["sd"]


def test_each_coil_is_calibrated_from_readings_in_which_it_alone_has_current(tmp_path):
    rig = rig_from_text(TWO_COILS)
    (tmp_path / "plan.yaml").write_text(PLAN)
    truth = {name: value for name, value in rig.nominal_values().items() if rig.parameters[name].tie is None}
    observations = simulate(rig, load_plan(tmp_path / "plan.yaml", rig), truth, seed=1)
    Session(rig, observations, "two coils").save(tmp_path / "both.zarr")
    jobs, _ = jobs_of(str(tmp_path / "both.zarr"), None, ("plain",), True, 0)
    assert [job.coil for job in jobs] == ["coil1", "coil2"]
    n_first = int((observations.current_A[:, 1] == 0.0).sum())
    assert jobs[0].n_readings == n_first
    only_one = observations.rows(observations.current_A[:, 1] == 0.0)
    Session(rig, only_one, "one coil").save(tmp_path / "one.zarr")
    path = str(tmp_path / "one.zarr")
    jobs, refused = jobs_of(path, None, ("plain",), True, 0)
    assert [job.coil for job in jobs] == ["coil1"]
    assert refused == {
        f"{path}, coil2, plain": "coil2 must carry current alone in some reading; it never does"
    }


def test_a_session_with_a_cause_is_said_first_and_not_covered_by_parameters_that_agree(fitted):
    table = fitted.table()
    table.loc[table["session"] == table["session"].iloc[-1], "probability"] = [0.0, 1.0]
    wrong = table["hypothesis"] != PLAIN
    table.loc[wrong & (table["session"] == table["session"].iloc[-1]), "log_evidence"] += 1e3
    names = _scalars(fitted)
    first, *others = _verdict(fitted, table, most_probable(table), names)
    (name,) = set(table["hypothesis"][wrong])
    assert first.startswith(f"Most probable is {name} in ")
    assert "(> 99 %): look at it with coilcal diagnose." in first
    assert not any(sentence.startswith("Every parameter agrees") for sentence in others)


def test_fits_whose_intervals_may_be_false_are_told(fitted, monkeypatch):
    assert fitted.cautions() == ["not judged (3 of 3): no posterior was sampled"]
    table = fitted.table()
    table["verdict"] = [
        "good" if session == table["session"][0] else "suspect" for session in table["session"]
    ]
    monkeypatch.setattr(BatchResult, "table", lambda self: table)
    (caution,) = fitted.cautions()
    assert caution.startswith("suspect (2 of 3): intervals hold only if nothing is wrong")
    assert caution[1:] in html.unescape(overview(fitted, "coilcal batch"))


def test_table_is_written_with_all_digits(fitted, tmp_path):
    import pandas as pd

    fitted.save_table(tmp_path)
    table = fitted.table()
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "summary.parquet"), table)
    read = pd.read_csv(tmp_path / "summary.csv")
    assert read["coil1.radius_m"].to_numpy() == pytest.approx(table["coil1.radius_m"].to_numpy(), rel=1e-15)


def test_no_session_and_an_unknown_cause_are_refused(sessions, tmp_path, address):
    with pytest.raises(InvalidInput, match="sessions must be at least one"):
        batch([], out=tmp_path)
    result = batch(
        sessions[:1], out=tmp_path, hypotheses=("gremlins",), scheduler=address, has_posterior=False
    )
    assert not result.names
    assert "gremlins" in next(iter(result.failed.values()))


PLAN = """\
schema_version: 1
name: one coil after the other
poses:
  calibration:
    arm1: {x_mm: {from: 0, to: 20, count: 3}, y_mm: 0, z_mm: 0}
    arm2: {q0_deg: 0, q1_deg: -90, q2_deg: -90, q3_deg: 0, q4_deg: 90, q5_deg: 0}
currents_A: [{coil1: 1}, {coil2: 1}]
order: raster
settle_s: 0.1
"""

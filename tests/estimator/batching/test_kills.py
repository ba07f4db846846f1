"""Real fits on real processes of which some are killed: the numbers are those of the batch that was let alone. `make batch-kills` does 200."""

from __future__ import annotations

import shutil
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from estimator import SamplerSettings
from estimator.batching import work
from estimator.batching.jobs import jobs_of
from estimator.batching.result import BatchResult
from estimator.batching.work import fit, sampled
from estimator.calibration.files import CALIBRATION
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.rig.rig import Rig
from estimator.store.session import Session
from estimator.store.staging import staged

SETTINGS = SamplerSettings(n_walkers=16, target_ess=10.0, largest_rhat=2.0, check_every=20)


@pytest.fixture(scope="module")
def sessions(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float], tmp_path_factory) -> list[Path]:
    """Six, of which one lost a few bytes; two of them cannot be stacked with the others."""
    folder = tmp_path_factory.mktemp("sessions")
    paths = [folder / f"s{i}.zarr" for i in range(6)]
    for i, path in enumerate(paths):
        readings = simulate(small_rig, small_plan, small_truth, seed=i)
        if i > 3:
            readings = replace(readings, current_A=readings.current_A * (1.0 + 0.01 * i))
        Session(small_rig, readings, f"session {i}").save(path)
    chunk = next((paths[3] / "field_sensor_T").rglob("c/*/*"))
    chunk.write_bytes(chunk.read_bytes()[:-5])
    return paths


def contents(result: BatchResult) -> dict[str, bytes]:
    """Every file of every fit and posterior."""
    files = (path for path in result.folder.rglob("*") if path.is_file())
    return {str(path.relative_to(result.folder)): path.read_bytes() for path in files}


def test_a_job_waits_for_another_process_that_samples_it_and_takes_its_posterior(
    sessions, tmp_path, monkeypatch
):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("must not be sampled twice")

    (job,), _ = jobs_of(str(sessions[0]), None, ("plain",), False, 0, SETTINGS)
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        assert fit([job], str(tmp_path / folder)) == {}
    assert sampled(job, str(tmp_path / "other"), SETTINGS) is None
    place = tmp_path / "one" / job.name
    monkeypatch.setattr(work, "calibrate", refuse)
    with ThreadPoolExecutor(1) as pool:
        with staged(place / "calibration", made=CALIBRATION) as orphan:
            waiting = pool.submit(sampled, job, str(tmp_path / "one"), SETTINGS)
            with pytest.raises(TimeoutError):
                waiting.result(timeout=1)
            shutil.copytree(tmp_path / "other" / job.name / "calibration", orphan)
        assert waiting.result(timeout=30) is None
    assert sorted(path.name for path in place.iterdir()) == ["calibration", "result.json"]


def test_two_attempts_at_one_fit_leave_one_result_and_nothing_else(sessions, tmp_path, monkeypatch):
    (job,), _ = jobs_of(str(sessions[0]), None, ("plain",), False, 0, SETTINGS)
    real = work.write_text
    others: list[Future[dict[str, str]]] = []

    with ThreadPoolExecutor(1) as pool:

        def overtaken(path: Path, text: str) -> None:
            real(path, text)
            if not others:
                others.append(pool.submit(fit, [job], str(tmp_path)))
                with pytest.raises(TimeoutError):  # it waits for the one that writes
                    others[0].result(timeout=2)

        monkeypatch.setattr(work, "write_text", overtaken)
        assert fit([job], str(tmp_path)) == {}
        assert [other.result(timeout=60) for other in others] == [{}]
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()] == [
        f"{job.name}/result.json"
    ]

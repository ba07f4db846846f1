"""Real fits on real processes of which some are killed: the numbers are those of the batch that was let alone. `make batch-kills` does 200."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from distributed import LocalCluster

from estimator import SamplerSettings
from estimator.batching import batch
from estimator.batching.result import BatchResult
from estimator.plan import Plan
from estimator.rig import Rig
from estimator.simulate import simulate
from estimator.store.session import Session

SETTINGS = SamplerSettings(n_walkers=16, target_ess=10.0, largest_rhat=2.0, check_every=20)


@pytest.fixture(scope="module")
def sessions(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float], tmp_path_factory) -> list[Path]:
    """Eight, of which one lost a few bytes; two of them cannot be stacked with the others."""
    folder = tmp_path_factory.mktemp("sessions")
    paths = [folder / f"s{i}.zarr" for i in range(8)]
    for i, path in enumerate(paths):
        readings = simulate(small_rig, small_plan, small_truth, seed=i)
        if i > 5:
            readings = replace(readings, current_A=readings.current_A * (1.0 + 0.01 * i))
        Session(small_rig, readings, f"session {i}").save(path)
    chunk = next((paths[3] / "field_sensor_T").rglob("c/*/*"))
    chunk.write_bytes(chunk.read_bytes()[:-5])
    return paths


def contents(result: BatchResult) -> dict[str, bytes]:
    """Every file of every fit and posterior."""
    files = (path for path in result.folder.rglob("*") if path.is_file())
    return {str(path.relative_to(result.folder)): path.read_bytes() for path in files}


def test_a_batch_with_workers_killed_ends_with_the_same_bytes_and_again_does_nothing(
    sessions: list[Path], tmp_path: Path
) -> None:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as local:

        def ask(out: str, tell: Callable[[int, int, str], None] | None = None) -> BatchResult:
            return batch(
                sessions, out=tmp_path / out, settings=SETTINGS, scheduler=local.scheduler_address, tell=tell
            )

        killed: list[int] = []

        def kill(done: int, _total: int, words: str) -> None:
            # Once while the other stacks are fitted, once while posteriors are sampled.
            if (words == "fitted" and not killed) or (words.endswith("sampled") and done == 2):
                killed.append(next(nanny.pid for nanny in local.workers.values() if nanny.pid))
                os.kill(killed[-1], signal.SIGKILL)

        disturbed = ask("disturbed", kill)
        alone = ask("alone")
        assert len(set(killed)) == 2
        for result in (disturbed, alone):
            assert (len(result.names), result.n_new) == (7, 14)
            assert list(result.failed) == [str(sessions[3])]
        assert contents(disturbed) == contents(alone)
        disturbed.save_table(tmp_path / "disturbed")
        alone.save_table(tmp_path / "alone")
        tables = [(tmp_path / name / "summary.csv").read_bytes() for name in ("disturbed", "alone")]
        assert tables[0] == tables[1]

        told: list[str] = []
        before = {path: path.stat().st_mtime_ns for path in disturbed.folder.rglob("*")}
        again = ask("disturbed", lambda _done, _total, words: told.append(words))
        assert (again.names, again.n_new) == (disturbed.names, 0)
        assert {words for words in told if "failed" not in words} == {"done before"}
        assert {path: path.stat().st_mtime_ns for path in disturbed.folder.rglob("*")} == before

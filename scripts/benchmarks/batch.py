"""Fits per second, stacked on the batch axis and one by one, in one process and over workers; `make bench-batch` runs it.

Times are processor seconds of the process (one by one, stacked) and wall-clock seconds of the cluster without its start.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from estimator import Observations, Rig, Session, calibrate, draw_truth, load_plan, load_rig, simulate
from estimator.batching.engine import Cluster, cluster
from estimator.batching.jobs import Job, jobs_of
from estimator.batching.stacked import stacked_fits
from estimator.batching.work import fit
from estimator.diagnosis import effort

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=16)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--posteriors", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    plan = load_plan(CONFIGS / "plans/paper_grid.yaml", rig)
    sessions = [simulate(rig, plan, draw_truth(rig, seed), seed=seed) for seed in range(options.fits)]
    print(
        f"{options.fits} sessions, {len(rig.free)} free parameters, {1 + effort.MORE_STARTS} starts each; {os.cpu_count()} processors"
    )
    for every in (10, 4, 1):
        show_stacking(rig, [session.calibration.rows(torch.arange(0, 125, every)) for session in sessions])
    show_workers(rig, sessions, options.workers)
    show_single(rig, sessions[: options.posteriors])


def show_stacking(rig: Rig, sessions: list[Observations]) -> None:
    alone = processor_seconds(
        lambda: [stacked_fits(rig, [session], [i], effort.MORE_STARTS) for i, session in enumerate(sessions)]
    )
    together = processor_seconds(
        lambda: stacked_fits(rig, sessions, list(range(len(sessions))), effort.MORE_STARTS)
    )
    n = len(sessions)
    print(
        f"{len(sessions[0]):4} readings: one by one {n / alone:.2f}, stacked {n / together:.2f} fits per processor second "
        f"({alone / together:.1f} times)"
    )


def show_workers(rig: Rig, sessions: list[Observations], numbers: list[int]) -> None:
    """Fits per second over processes, and an extrapolation to more of them from processor seconds."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{i}.zarr" for i in range(len(sessions))]
        for path, observations in zip(paths, sessions, strict=True):
            Session(rig, observations, "simulated").save(path)
        for n in numbers:
            out = Path(folder) / f"workers{n}"
            out.mkdir()
            with cluster(n, None) as workers:
                per_fit_s = throughput(workers, [str(path) for path in paths], n, out)
        if numbers:
            extrapolate(*per_fit_s)


def throughput(workers: Cluster, paths: list[str], n: int, out: Path) -> tuple[float, float]:
    """Processor seconds per fit in a worker, and in the client with its scheduler."""
    arguments = (None, ("plain",), False, 0)
    warm = jobs_of(paths[0], *arguments)[0]
    (out / "warm").mkdir()
    workers.run({i: (fit, (warm, str(out / "warm"))) for i in range(n)}, lambda name, result: None)
    begin_s, begin_client_s = time.perf_counter(), time.process_time()
    in_workers_s: list[float] = []
    jobs: list[Job] = []

    def described(_: object, result: Any) -> None:
        in_workers_s.append(result[0])
        jobs.extend(result[1][0])

    workers.run({path: (timed, (jobs_of, path, *arguments)) for path in paths}, described)
    stacks = [jobs[i : i + 4] for i in range(0, len(jobs), 4)]
    calls = {i: (timed, (fit, stack, str(out))) for i, stack in enumerate(stacks)}
    workers.run(calls, lambda _, result: in_workers_s.append(result[0]))
    seconds, client_s = time.perf_counter() - begin_s, time.process_time() - begin_client_s
    in_worker, in_client = sum(in_workers_s) / len(jobs), client_s / len(jobs)
    print(
        f"{n} workers, stacks of 4, sessions read twice: {len(jobs) / seconds:.2f} fits per second; processor seconds per fit: "
        f"{in_worker:.2f} in workers, {in_client:.3f} in the client with its scheduler"
    )
    return in_worker, in_client


def extrapolate(in_worker: float, in_client: float) -> None:
    rates = ", ".join(f"{n}: {1.0 / (in_client + in_worker / n):.1f}" for n in (2, 8, 32, 128))
    print(f"fits per second of n workers, 1 / (client + worker / n), each on a processor of its own: {rates}")


def show_single(rig: Rig, sessions: list[Observations]) -> None:
    """`coilcal calibrate` of one session: search from many starts, loop counts, posterior of 2000 effective samples."""
    seconds = processor_seconds(
        lambda: [
            calibrate(Session(rig, readings, "simulated"), seed=i) for i, readings in enumerate(sessions)
        ]
    )
    print(
        f"one posterior, by calibrate or by the second stage of a batch: {seconds / len(sessions):.1f} processor seconds"
    )


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    begin_s = time.process_time()
    result = function(*arguments)
    return time.process_time() - begin_s, result


def processor_seconds(work: object) -> float:
    assert callable(work)
    begin = time.process_time()
    work()
    return time.process_time() - begin


if __name__ == "__main__":
    main()

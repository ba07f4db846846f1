"""Fits per second: stacked on the batch axis against one by one, in one process and over workers; `make bench-batch` runs it.

Times are processor seconds of the process (one by one, stacked) and wall seconds of the cluster, without its start.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from estimator import Observations, Rig, Session, draw_truth, load_plan, load_rig, simulate
from estimator.batching.engine import cluster
from estimator.batching.jobs import jobs_of
from estimator.batching.work import MORE_STARTS, fit
from estimator.inference.stacked import stacked_fits

CONFIGS = Path(__file__).resolve().parent.parent / "configs"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=16)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    options = parser.parse_args()
    torch.set_num_threads(1)
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    plan = load_plan(CONFIGS / "plans/paper_grid.yaml", rig)
    sessions = [simulate(rig, plan, draw_truth(rig, seed), seed=seed) for seed in range(options.fits)]
    print(
        f"{options.fits} sessions, {len(rig.free)} free parameters, {1 + MORE_STARTS} starts each; {os.cpu_count()} processors"
    )
    for every in (10, 4, 1):
        show_stacking(rig, [session.calibration.rows(torch.arange(0, 125, every)) for session in sessions])
    show_workers(rig, sessions, options.workers)


def show_stacking(rig: Rig, sessions: list[Observations]) -> None:
    alone = processor_seconds(
        lambda: [stacked_fits(rig, [one], [i], MORE_STARTS) for i, one in enumerate(sessions)]
    )
    together = processor_seconds(lambda: stacked_fits(rig, sessions, list(range(len(sessions))), MORE_STARTS))
    n = len(sessions)
    print(
        f"{len(sessions[0]):4} readings: one by one {n / alone:.2f}, stacked {n / together:.2f} fits per processor second "
        f"({alone / together:.1f} times)"
    )


def show_workers(rig: Rig, sessions: list[Observations], numbers: list[int]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{i}.zarr" for i in range(len(sessions))]
        for path, observations in zip(paths, sessions, strict=True):
            Session(rig, observations, "simulated").save(path)
        jobs = [jobs_of(str(path), "", ("plain",), False, 0)[0][0] for path in paths]
        stacks = [jobs[i : i + 4] for i in range(0, len(jobs), 4)]
        for n in numbers:
            out = Path(folder) / f"workers{n}"
            out.mkdir()
            with cluster(n, None) as where:
                warm = {i: (fit, (stacks[0][:1], str(Path(folder)))) for i in range(n)}
                where.run(warm, lambda name, result: None)
                begin = time.perf_counter()
                where.run(
                    {i: (fit, (stack, str(out))) for i, stack in enumerate(stacks)}, lambda name, result: None
                )
                seconds = time.perf_counter() - begin
            print(f"{n} workers, stacks of 4: {len(jobs) / seconds:.2f} fits per second")


def processor_seconds(work: object) -> float:
    assert callable(work)
    begin = time.process_time()
    work()
    return time.process_time() - begin


if __name__ == "__main__":
    main()

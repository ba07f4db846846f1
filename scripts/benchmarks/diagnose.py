"""Time of a diagnosis of 512 readings with all causes as candidates, without sampling; `make bench-diagnose` runs it."""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import torch

from estimator import Plan, Rig, Session, diagnose, draw_truth, load_plan, load_rig, simulate
from estimator.benchmarks.sessions import grid_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PLAN = grid_plan(8)
HIDDEN = (
    {},
    {"axis_gain.x": 0.01},
    {"cross_axis.xy": 0.01},
    {"coil_heating.loss_per_A2": 0.002},
    {"iron_plate": 0.5},
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--threads", type=int, default=1, help="of one operation; pieces run on all cores anyway"
    )
    parser.add_argument("--repeats", type=int, default=5, help="sessions of each kind")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.yaml"
        path.write_text(PLAN)
        plan = load_plan(path, rig)
    print(f"{options.threads} threads, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    first_s, _ = _timed(rig, plan, options.repeats, {})
    print(f"the first diagnosis of the process, nothing hidden, which loads and compiles: {first_s:.1f} s")
    for hidden in HIDDEN:
        runs = [_timed(rig, plan, seed, hidden) for seed in range(options.repeats)]
        seconds = [run_s for run_s, _ in runs]
        outcomes = Counter(outcome for _, outcome in runs)
        print(
            f"{', '.join(hidden) or 'nothing'} hidden: {statistics.median(seconds):.2f} s ({min(seconds):.2f} to {max(seconds):.2f}); "
            + ", ".join(f"{n} times {outcome}" for outcome, n in outcomes.items()),
            flush=True,
        )


def _timed(rig: Rig, plan: Plan, seed: int, hidden: Mapping[str, float]) -> tuple[float, str]:
    """Seconds of the clock that the diagnosis of one simulated session takes, and what it says."""
    truth = draw_truth(rig, seed)
    readings, validation = (simulate(rig, plan, truth, seed=s, hidden=hidden) for s in (seed, 100 + seed))
    begin = time.perf_counter()
    diagnosis = diagnose(
        Session(rig, readings, "simulated"), validation=Session(rig, validation, "again"), seed=seed
    )
    taken_s = time.perf_counter() - begin
    names = ", ".join(diagnosis.label(named.cause) for named in diagnosis.causes)
    return taken_s, f"{diagnosis.verdict} {names}".strip()


if __name__ == "__main__":
    main()

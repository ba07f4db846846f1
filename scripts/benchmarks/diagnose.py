"""Time of a diagnosis of 512 readings with all causes as candidates, without the final sampling; `make bench-diagnose` runs it."""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import torch

from estimator import Session, diagnose, draw_truth, load_plan, load_rig, simulate
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
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.yaml"
        path.write_text(PLAN)
        plan = load_plan(path, rig)
    print(f"{options.threads} threads, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    for seed, hidden in enumerate(HIDDEN):
        truth = draw_truth(rig, seed)
        readings, validation = (simulate(rig, plan, truth, seed=s, hidden=hidden) for s in (seed, 100 + seed))
        begin, processor = time.perf_counter(), time.process_time()
        diagnosis = diagnose(
            Session(rig, readings, "simulated"), validation=Session(rig, validation, "again"), seed=seed
        )
        print(
            f"{len(readings)} readings, hidden {', '.join(hidden) or 'nothing'}: {diagnosis.verdict} "
            f"{', '.join(diagnosis.label(named.cause) for named in diagnosis.causes)} in {time.perf_counter() - begin:.1f} s "
            f"({time.process_time() - processor:.1f} processor seconds)",
            flush=True,
        )


if __name__ == "__main__":
    main()

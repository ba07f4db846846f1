"""Where the time of a calibration, diagnoses and predictions goes, by function; `make bench-profile` runs it.

Each column is one piece of work under Python's profiler, which makes short functions look longer. A share is the time inside a function
and all that it calls, so shares of functions that call each other do not add up. Work is done once before, so that nothing is loaded or
translated.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import time
from collections.abc import Callable
from pathlib import Path

import torch

from estimator import Session, calibrate, diagnose, draw_truth, load_plan, load_rig, simulate
from estimator.benchmarks.machine import processor
from scripts.benchmarks.diagnose import HIDDEN, PLAN
from scripts.benchmarks.machine import use_cores

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
# Words, end of the file, name of the function.
FUNCTIONS = (
    ("stages of a calibration", "", ""),
    ("point estimate", "point_estimate.py", "point_estimate"),
    ("whole counts: fits of tuples", "lattice.py", "count_mixture"),
    ("proposal fitted before the chain", "adaptation.py", "adapted"),
    ("emcee's steps", "ensemble.py", "run_mcmc"),
    ("effective samples, R-hat", "convergence.py", "convergence"),
    ("errors, coverage, summary", "summary.py", "summary"),
    ("stages of a diagnosis", "", ""),
    ("fits, of the rig and of causes", "fitting.py", "fit_rig"),
    ("mistakes of the record", "record_mistakes.py", "without_record_mistakes"),
    ("what is wrong, asked", "answer.py", "answer"),
    ("columns of all causes", "candidates.py", "candidates"),
    ("items that may matter", "listed.py", "offered"),
    ("columns of departures", "departures.py", "departures"),
    ("draws of slots", "slots.py", "sample"),
    ("fits of what leads", "expansion.py", "moved"),
    ("unseen readings", "validation.py", "improvement_of"),
    ("corrections without a name", "correcting.py", "corrected"),
    ("error budget", "budget.py", "budget"),
    ("what they have in common", "", ""),
    ("Levenberg-Marquardt", "levenberg_marquardt.py", "levenberg_marquardt"),
    ("predictions with derivatives", "likelihood.py", "to_first_order"),
    ("density, without derivatives", "likelihood.py", "log_likelihood"),
    ("predicted readings", "measurement_model.py", "predict"),
    ("field at many draws", "room_field.py", "field_by_point_T"),
    ("sums over loops, in machine code", "kernel.py", "sum_of_loops"),
    ("their derivatives, in machine code", "kernel.py", "slopes_of_loops"),
    ("torch's backward passes", "graph.py", "_engine_run_backward"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--top", type=int, default=0, help="print so many functions of each, by their own time"
    )
    options = parser.parse_args()
    use_cores(1)
    torch.set_num_threads(1)
    print(
        f"{processor()}, load {os.getloadavg()[0]:.1f}, one core; shares of the processor time of each column"
    )
    profiles: dict[str, tuple[float, pstats.Stats]] = {}
    for name, work in tasks().items():
        work()
        profiles[name] = profiled(work)
        if options.top:
            profiles[name][1].sort_stats("tottime").print_stats(options.top)
    table(profiles)


def tasks() -> dict[str, Callable[[], object]]:
    """Pieces of work by name."""
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    grid = load_plan(CONFIGS / "plans/paper_grid.yaml", rig)
    truth = draw_truth(rig, 0)
    session = Session(rig, simulate(rig, grid, truth, seed=0), "simulated")
    calibration = calibrate(session, seed=0)
    points_m = torch.rand(1000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 0.05
    points_m = points_m + torch.tensor([0.0, 0.0, 0.02], dtype=torch.float64)
    work: dict[str, Callable[[], object]] = {
        "calibrate": lambda: calibrate(session, seed=0),
        "predict": lambda: calibration.field_interval(points_m, {"coil1": 1.0}),
    }
    plan_file = Path(os.environ.get("TMPDIR", "/tmp")) / f"plan_{os.getpid()}.yaml"
    plan_file.write_text(PLAN)
    plan = load_plan(plan_file, rig)
    plan_file.unlink()
    for hidden in HIDDEN:
        readings, unseen = (
            Session(rig, simulate(rig, plan, truth, seed=s, hidden=hidden), "simulated") for s in (0, 100)
        )
        work[next(iter(hidden), "nothing")] = lambda readings=readings, unseen=unseen: diagnose(
            readings, validation=unseen, seed=0
        )
    return work


def profiled(work: Callable[[], object]) -> tuple[float, pstats.Stats]:
    """Processor seconds without the profiler, and a profile of another run by processor time."""
    begin_s = time.process_time()
    work()
    seconds = time.process_time() - begin_s
    profile = cProfile.Profile(time.process_time)
    profile.runcall(work)
    return seconds, pstats.Stats(profile)


def table(profiles: dict[str, tuple[float, pstats.Stats]]) -> None:
    print("| | " + " | ".join(profiles) + " |")
    print("|---|" + "---|" * len(profiles))
    print("| processor seconds | " + " | ".join(f"{seconds:.2f}" for seconds, _ in profiles.values()) + " |")
    for words, file, function in FUNCTIONS:
        if not function:
            print(f"| *{words}* |" + " |" * len(profiles))
            continue
        shares = [share(stats, file, function) for _, stats in profiles.values()]
        if any(shares):
            print(f"| {words} | " + " | ".join(f"{each:.0%}" if each else "" for each in shares) + " |")


def share(stats: pstats.Stats, file: str, function: str) -> float:
    """Share of a profile's time inside a function; 0 if it was never called."""
    entries = stats.stats.items()  # type: ignore[attr-defined]
    inside_s = sum(row[3] for (path, _, name), row in entries if name == function and path.endswith(file))
    return float(inside_s / stats.total_tt)  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()

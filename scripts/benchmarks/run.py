"""Speed beside magpylib, SciPy, plain emcee and NumPyro, in one run on one machine; `make bench` runs it.

It measures loop and winding fields per second (`field`), the time to field and gradient at one pose (`latency`), and
effective samples per second of the slowest parameter (`sampling`).

Numbers are medians over repeats with their extremes. Compare the ratios: absolute numbers belong to the
machine that is printed with them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from estimator.benchmarks.machine import processor
from scripts.benchmarks.machine import peak_memory_GB, use_cores

GOAL_S, GOAL_ESS, GOAL_GB = 10.0, 10_000.0, 1.5  # on two cores
PACKAGES = ("torch", "numpy", "scipy", "emcee", "arviz", "magpylib")


def main() -> None:
    options = arguments()
    cores = use_cores(options.threads)
    # Imported now: OpenMP, MKL and XLA count the cores when they are loaded.
    import torch

    from scripts.benchmarks.field import fields
    from scripts.benchmarks.latency import latency, show_latency
    from scripts.benchmarks.sampling import sampling

    torch.set_num_threads(1)
    machine = {
        "processor": processor(),
        "cores_used": cores,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{name: version(name) for name in (*PACKAGES, *(("jax", "numpyro") if options.numpyro else ()))},
    }
    print(", ".join(f"{key} {value}" for key, value in machine.items()))
    print(f"seed {options.seed}, {options.repeats} repeats: median (smallest to largest)")
    result: dict[str, Any] = {"machine": machine, "seed": options.seed, "repeats": options.repeats}
    if options.only in (None, "sampling"):
        result["sampling"] = []
        for table in sampling(options):
            result["sampling"].append(table)
            show_sampling(table, options.ess)
        if options.ess >= GOAL_ESS:
            result["goal"] = goal(result["sampling"][0], options.ess, cores)
    if options.only in (None, "latency"):
        result["latency"] = latency(options)
        show_latency(result["latency"])
    if options.only in (None, "fields"):
        result["fields"] = fields(options)
        for title, rows in result["fields"].items():
            show_fields(title, rows)
    result["peak_memory_GB"] = peak_memory_GB()
    print(f"\npeak memory of the whole process, all contenders: {result['peak_memory_GB']:.2f} GB")
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=1, help="cores to use; fields are split over them")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--ess", type=float, default=GOAL_ESS, help="effective samples of every parameter")
    parser.add_argument("--stretch-steps", type=int, default=3000, help="steps on the real-valued counts")
    parser.add_argument("--numpyro", action="store_true", help="NUTS as well (pip install '.[bench]')")
    parser.add_argument(
        "--sides", type=int, nargs="*", default=(5, 8), help="places along each axis of a grid to sample"
    )
    parser.add_argument(
        "--free", nargs="*", default=("nothing", "axis_gain"), help="effects to sample, one at a time"
    )
    parser.add_argument("--only", choices=("fields", "latency", "sampling"))
    parser.add_argument(
        "--tiny",
        action="store_true",
        help="run for a few seconds to see that it works; the timings mean nothing",
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.tiny:
        options.repeats, options.ess, options.stretch_steps, options.sides = 1, 200.0, 60, (5,)
    return options


def show_fields(title: str, rows: dict[str, dict[str, Any]]) -> None:
    slowest = next(name for name in rows if name.startswith("magpylib"))
    print(f"\n{title}")
    print(f"{'':40} {'fields a second':>29} {'ratio to':>9} {'largest':>10}")
    print(f"{'':40} {'':>29} {'magpylib':>9} {'difference':>10}")
    for name, row in rows.items():
        ratio = row["per_second"][0] / rows[slowest]["per_second"][0]
        print(
            f"{name:40} {spread(row['per_second'], '.3g'):>29} {ratio:9.1f} {row['largest_difference']:10.0e}"
        )


def show_sampling(result: dict[str, Any], target_ess: float) -> None:
    print(f"\n{result['title']} (processor time throughout)")
    for name, seconds in result["set_up_s"].items():
        print(f"  {name}: {spread(seconds, '.1f')} s")
    print(
        f"{'':50} {'evaluations':>11} {'smallest ESS':>12} {'R-hat':>6} {'ESS/evaluation':>14} {'ESS a second':>25} {'ratio':>6} "
        f"{f's to {target_ess:.0f}':>12}"
    )
    plain = next(row for name, row in result["rows"].items() if name.startswith("emcee"))
    for name, row in result["rows"].items():
        rate = row["ess_per_s"]
        reached = "not reached" if rate[0] == 0.0 else f"about {target_ess / rate[0]:.0f}"
        reached = spread(row["seconds"], ".1f") if row["is_reached"] else reached
        print(
            f"{name:50} {row['evaluations']:11d} {row['smallest_ess']:12.0f} {row['largest_rhat']:6.3f} "
            f"{row['smallest_ess'] / row['evaluations']:14.4f} "
            f"{spread(rate, '.3g'):>25} {rate[0] / plain['ess_per_s'][0]:6.1f} {reached:>12}"
        )
    print(
        "ESS is the smaller of bulk and tail of the slowest parameter; with R-hat above 1.01 it is a guess."
    )


def goal(result: dict[str, Any], target_ess: float, cores: int) -> dict[str, Any]:
    seconds, memory_GB = (
        result["rows"]["coilcal, whole counts"]["seconds"][0],
        result["peak_memory_GB"],
    )
    is_met = seconds <= GOAL_S and memory_GB < GOAL_GB
    print(
        f"goal, {GOAL_ESS:.0f} effective samples of every parameter in {GOAL_S:.0f} s on two cores below {GOAL_GB} GB: "
        f"{target_ess:.0f} in {seconds:.1f} s on {cores}, peak {memory_GB:.2f} GB, {'met' if is_met else 'not met'}"
    )
    return {"seconds": seconds, "peak_memory_GB": memory_GB, "is_met": is_met}


def spread(values: list[float], form: str) -> str:
    middle, low, high = (format(value, form) for value in values)
    return f"{middle} ({low} to {high})"


if __name__ == "__main__":
    main()

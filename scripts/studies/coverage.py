"""Simulation-based calibration of posteriors over many seeded repeats; `make coverage` runs it.

Every repeat is appended to a file as it ends, so an interrupted study continues. At the end it prints the coverage of 90 % intervals and
the uniformity of ranks of each parameter, and for loop counts the stated probability beside the true frequency.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from pathlib import Path
from typing import Any

import numpy as np

from tests.statistics.coverage import count_calibration, coverage90, one_repeat, uniformity


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/coverage.jsonl"))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    done = read(options.out)
    seeds = range(options.first_seed, options.first_seed + options.repeats)
    missing = [seed for seed in seeds if seed not in done]
    with multiprocessing.get_context("spawn").Pool(options.workers) as pool, options.out.open("a") as file:
        for i, repeat in enumerate(pool.imap_unordered(one_repeat, missing), start=1):
            file.write(json.dumps(repeat) + "\n")
            file.flush()
            done[repeat["seed"]] = repeat
            print(f"{i} of {len(missing)}: seed {repeat['seed']}, {repeat['seconds']:.1f} s", file=sys.stderr)
    show([done[seed] for seed in seeds])


def read(path: Path) -> dict[int, dict[str, Any]]:
    if not path.exists():
        return {}
    return {repeat["seed"]: repeat for repeat in map(json.loads, path.read_text().splitlines())}


def show(repeats: list[dict[str, Any]]) -> None:
    n = len(repeats)
    not_converged = sum(not repeat["is_converged"] for repeat in repeats)
    sd = np.sqrt(0.09 / n)
    print(
        f"{n} repeats, {not_converged} not converged; one Monte Carlo standard deviation of coverage is {sd:.1%}"
    )
    print(f"{'parameter':38} {'coverage of 90 %':>17} {'P(KS)':>8}")
    coverage, p_value = coverage90(repeats), uniformity(repeats)
    for name, share in coverage.items():
        print(f"{name:38} {share:17.1%} {p_value[name]:8.3f}")
    print("loop counts: stated probability beside the frequency with which they were true")
    for row in count_calibration(repeats):
        print(
            f"  {row['from']:.1f} to {row['to']:.1f}: {row['cases']:5d} cases, stated {row['stated']:.3f}, "
            f"true {row['true']:.3f}, z = {row['z']:+.1f}"
        )


if __name__ == "__main__":
    main()

"""Section 4.2 of the paper (Table 1, Fig 8): what radius, wire radius, axial and radial loops change, and which are worth fitting.

Run `python scripts/sensitivity.py`; it prints the shares of every parameter and pair, Sobol indices and the Fisher information, and writes
the figures. The paper's levels are not at hand: seven levels each, one prior standard deviation about its simulated coil.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

from estimator import Rig, load_plan, load_rig
from estimator.plan import observations_of
from estimator.plots import interactions, main_effects
from estimator.records import Observations
from estimator.sensitivity import factorial, information, levels_about, rms_field, sobol

ROOT = Path(__file__).resolve().parent.parent
NAMES = tuple(f"coil1.{key}" for key in ("radius_m", "wire_radius_m", "axial_loops", "radial_loops"))
TRUTH = dict(zip(NAMES, (0.051, 0.49e-3, 48.0, 25.0), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rig", type=Path, default=ROOT / "configs/paper_simulation.yaml")
    parser.add_argument("--plan", type=Path, default=ROOT / "configs/plans/paper_grid.yaml")
    parser.add_argument("--levels", type=int, default=7)
    parser.add_argument("--out", type=Path, default=ROOT / "out/sensitivity")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rig = load_rig(options.rig).with_values(TRUTH)
    plan = load_plan(options.plan, rig)
    readings = observations_of(plan, rig, np.random.default_rng(0)).calibration
    options.out.mkdir(parents=True, exist_ok=True)
    show_factorial(rig, readings, options.levels, options.out)
    show_information(rig, readings)


def show_factorial(rig: Rig, readings: Observations, n_levels: int, out: Path) -> None:
    levels = levels_about(rig, NAMES, n_levels)
    response = rms_field(rig, readings, NAMES)
    begin = time.perf_counter()
    runs = factorial(response, levels)
    elapsed = time.perf_counter() - begin
    print(f"{runs.response.size} runs over {len(readings)} readings in {elapsed:.1f} s; rms field "
          f"{1e3 * runs.response.mean():.3f} mT, {1e3 * runs.response.min():.3f} to {1e3 * runs.response.max():.3f} mT")  # fmt: skip
    indices = sobol(response, levels)
    print(
        f"\n{'parameter':22} {'from':>9} {'to':>9} {'main effect / mT':>17} {'variance':>9} {'Sobol first':>12} {'total':>7}"
    )
    shares = runs.shares()
    for i, name in enumerate(NAMES):
        effect = 1e3 * np.ptp(runs.main_effect(name))
        print(
            f"{name:22} {levels[name][0]:9.4g} {levels[name][-1]:9.4g} {effect:17.4f} {shares[(name,)]:9.2%} "
            f"{indices.first[i]:12.4f} {indices.total[i]:7.4f}"
        )
    for pair in sorted((key for key in shares if len(key) == 2), key=lambda key: -shares[key]):
        print(f"{' x '.join(pair):60} {shares[pair]:9.4%}")
    print(f"{'interactions of three and four':60} {1.0 - sum(shares.values()):9.4%}")
    for name, drawn in (
        ("main_effects", main_effects(runs, f"{rig.name}: main effects")),
        ("interactions", interactions(runs, f"{rig.name}: interactions")),
    ):
        drawn.savefig(out / f"{name}.png", dpi=90, bbox_inches="tight")
        print(out / f"{name}.png")


def show_information(rig: Rig, readings: Observations) -> None:
    pose = tuple(p.name for p in rig.free if p.name not in NAMES and not p.name.endswith("noise_T"))
    for title, names in (("pose known", NAMES), ("pose free", NAMES + pose)):
        found = information(rig, readings, names)
        print(f"\nFisher information, {title}; standard deviations in units of the prior's")
        print(f"{'direction':>12}" + "".join(f"{n.partition('.')[2]:>30}" for n in names[: len(NAMES)]))
        for sd, vector in zip(found.sd_by_direction, found.directions.T, strict=True):
            print(f"{sd:12.3g}" + "".join(f"{weight:30.3f}" for weight in vector[: len(NAMES)]))
        for name, alone, together in zip(names, found.alone_sd, found.together_sd, strict=True):
            print(f"{name:34} known others: {alone:10.2g}   all free: {together:10.2g}")
        print(found.words())


if __name__ == "__main__":
    main()

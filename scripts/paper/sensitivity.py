"""Section 4.2 of the paper (Table 1, Fig 8): effects of radius, wire radius, axial and radial loops, and which are worth fitting.

Run `python -m scripts.paper.sensitivity`; it prints the shares of every parameter and pair, Sobol indices and the Fisher information, and
writes the figures. The paper's levels are not at hand: here each parameter has seven within one prior standard deviation of its simulated
coil.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from estimator import Rig, load_plan, load_rig
from estimator.model.sensitivity import (
    Factorial,
    Information,
    Sobol,
    factorial,
    information,
    levels_about,
    rms_field,
    sobol,
)
from estimator.readings.observations import Observations
from estimator.readings.plan import observations_of
from estimator.reporting.plots import interactions, main_effects
from scripts.paper.tables import NAMES, NOT_AT_HAND, TRUTH, table

ROOT = Path(__file__).resolve().parents[2]
SHOWN_WEIGHT = 0.15  # least weight of a parameter that is shown in a direction


def study(out: Path, n_levels: int = 7) -> str:
    """Table 1, Sobol indices and Fisher information, and the figures as files."""
    out.mkdir(parents=True, exist_ok=True)
    rig = load_rig(ROOT / "configs/paper_simulation.yaml").with_values(TRUTH)
    plan = load_plan(ROOT / "configs/plans/paper_grid.yaml", rig)
    readings = observations_of(plan, rig, np.random.default_rng(0)).calibration
    levels, response = levels_about(rig, NAMES, n_levels), rms_field(rig, readings, NAMES)
    runs = factorial(response, levels)
    for name, drawn in {
        "main_effects": main_effects(runs, f"{rig.name}: main effects"),
        "interactions": interactions(runs, f"{rig.name}: interactions"),
    }.items():
        drawn.savefig(out / f"{name}.png", dpi=90, bbox_inches="tight")
    return "\n".join((effects(runs, sobol(response, levels)), fisher(rig, readings)))


def effects(runs: Factorial, indices: Sobol) -> str:
    """Shares of the variance of the rms field over the readings."""
    shares = runs.shares()
    rows = [
        (name, NOT_AT_HAND, f"{runs.levels[i][0]:.4g} to {runs.levels[i][-1]:.4g}", f"{1e3 * np.ptp(runs.main_effect(name)):.3f}",
         f"{100 * shares[(name,)]:.2f} %", f"{indices.first[i]:.4f}", f"{indices.total[i]:.4f}")
        for i, name in enumerate(runs.names)
    ]  # fmt: skip
    header = ("parameter", "paper", "levels (SI)", "main effect (mT)", "share alone", "Sobol first", "total")
    title = f"Table 1: {runs.response.size} runs, rms field {1e3 * runs.response.mean():.2f} mT"
    pairs = sorted((key for key in shares if len(key) == 2), key=lambda key: -shares[key])
    words = [(" x ".join(pair), f"{100 * shares[pair]:.3f} %") for pair in pairs]
    words.append(("of three and four", f"{100 * (1.0 - sum(shares.values())):.3f} %"))
    return "\n".join((table(title, header, rows), table("Interactions", ("of", "share"), words)))


def fisher(rig: Rig, readings: Observations) -> str:
    """Fisher information of the readings, with the pose known and with it free."""
    pose = tuple(p.name for p in rig.free if p.name not in NAMES and not p.name.endswith("noise_T"))
    parts = []
    for title, names in (("pose known", NAMES), ("pose free", NAMES + pose)):
        fisher_information = information(rig, readings, names)
        rows = [
            (f"{sd:.2g}", _combination(fisher_information, i))
            for i, sd in enumerate(fisher_information.sd_by_direction)
        ]
        header = ("sd over that of the prior", "direction in units of the prior")
        parts += [
            table(f"Fisher information, {title}: eigenvectors", header, rows),
            fisher_information.words(),
            "",
        ]
    return "\n".join(parts)


def _combination(fisher_information: Information, direction: int) -> str:
    weight = fisher_information.directions[:, direction]
    large = [i for i in np.argsort(-np.abs(weight)) if abs(weight[i]) > SHOWN_WEIGHT]
    return ", ".join(f"{weight[i]:+.2f} {fisher_information.names[i].rpartition('.')[2]}" for i in large)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--levels", type=int, default=7)
    parser.add_argument("--out", type=Path, default=ROOT / "out/paper")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(study(options.out, options.levels))


if __name__ == "__main__":
    main()

"""Section 4.2 of the paper (Table 1, Fig 8): effects of radius, wire radius, axial and radial loops, and which are worth fitting.

Run `python -m scripts.paper.sensitivity`; it prints the shares of every parameter and pair, Sobol indices and the Fisher information, and
writes the figures. The levels are those of Table 1, seven of each parameter about the truth of Table 3. Two responses: the paper's, which
is the RMSE (eq 2) against the truth, and the rms field.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from estimator import Rig, load_plan, load_rig
from estimator.field.winding import Winding, winding_field_per_ampere
from estimator.readings.observations import Observations
from estimator.readings.plan import observations_of
from scripts.paper import printed, programme
from scripts.paper.factorial import (
    Factorial,
    Information,
    Sobol,
    factorial,
    information,
    rms_change,
    rms_field,
    sobol,
)
from scripts.paper.factorial_plots import interactions, main_effects
from scripts.paper.tables import CURRENT_A, NAMES, TRUTH, table

ROOT = Path(__file__).resolve().parents[2]
SHOWN_WEIGHT = 0.15  # least weight of a parameter that is shown in a direction


def study(out: Path, n_levels: int = 7) -> str:
    """Table 1 with both responses, Sobol indices and Fisher information, and the figures as files."""
    out.mkdir(parents=True, exist_ok=True)
    rig = load_rig(ROOT / "configs/paper_simulation.yaml").with_values(TRUTH)
    plan = load_plan(ROOT / "configs/plans/paper_grid.yaml", rig)
    readings = observations_of(plan, rig, np.random.default_rng(0)).calibration
    levels = table_1(n_levels)
    change_T = rms_change(rig, readings, NAMES)
    responses = {
        "RMSE against the truth": (lambda values: 0.5 * change_T(values), "rmse_"),
        "rms field": (rms_field(rig, readings, NAMES), ""),
    }
    parts = []
    for label, (response, prefix) in responses.items():
        runs = factorial(response, levels, label)
        for name, drawn in {
            "main_effects": main_effects(runs, f"{rig.name}: main effects"),
            "interactions": interactions(runs, f"{rig.name}: interactions"),
        }.items():
            drawn.savefig(out / f"{prefix}{name}.png", dpi=90, bbox_inches="tight")
        parts.append(effects(runs, sobol(response, levels)))
    return "\n".join((*parts, other_grids(levels), fisher(rig, readings)))


def table_1(n_levels: int) -> dict[str, np.ndarray]:
    """Levels of Table 1, in SI."""
    ends = {**{key: np.array(mm) / 1e3 for key, mm in printed.LEVELS_MM.items()}, **printed.LEVELS_COUNT}
    return {name: np.linspace(*ends[name.rpartition(".")[2].removesuffix("_m")], n_levels) for name in NAMES}


def effects(runs: Factorial, indices: Sobol) -> str:
    """Ranges of the main effects, and shares of the variance."""
    shares = runs.shares()
    rows = [
        (name, f"{runs.levels[i][0]:.4g} to {runs.levels[i][-1]:.4g}", f"{1e3 * np.ptp(runs.main_effect(name)):.3f}",
         f"{100 * shares[(name,)]:.2f} %", f"{indices.first[i]:.4f}", f"{indices.total[i]:.4f}")
        for i, name in enumerate(runs.names)
    ]  # fmt: skip
    header = (
        "parameter",
        "levels of Table 1 (SI)",
        "main effect (mT)",
        "share alone",
        "Sobol first",
        "total",
    )
    title = f"Fig 8, {runs.label}: {runs.response.size} runs, mean {1e3 * runs.response.mean():.3f} mT"
    pairs = sorted((key for key in shares if len(key) == 2), key=lambda key: -shares[key])
    words = [(" x ".join(pair), f"{100 * shares[pair]:.3f} %") for pair in pairs]
    words.append(("of three and four", f"{100 * (1.0 - sum(shares.values())):.3f} %"))
    return "\n".join(
        (table(title, header, rows), table(f"Interactions, {runs.label}", ("of", "share"), words))
    )


def other_grids(levels: dict[str, np.ndarray]) -> str:
    """The claims of Fig 8 by where the grid lies, which the paper does not say: RMSE against the truth as response."""
    runs = torch.cartesian_prod(*(torch.from_numpy(np.asarray(v, dtype=float)) for v in levels.values()))
    radius_m, wire_m, axial, radial = runs.unbind(-1)
    windings = Winding(radius_m, axial, radial, 2.0 * wire_m, 2.0 * wire_m)
    rows = []
    for near_m in (0.001, 0.005, 0.015, 0.04, 0.1):
        places_m = torch.from_numpy(programme.box_m(5, near_m))
        true = programme.field_per_ampere(places_m.numpy(), printed.SIMULATED_TRUTH)
        error = winding_field_per_ampere(places_m, windings, programme.RULE).numpy() - true
        response_T = 0.5 * CURRENT_A * np.sqrt((error**2).sum(-1).mean(-1))
        factors = Factorial(
            NAMES, tuple(levels.values()), response_T.reshape([len(v) for v in levels.values()])
        )
        shares = factors.shares()
        order = sorted(NAMES, key=lambda name: -np.ptp(factors.main_effect(name)))
        pairs = ((NAMES[0], NAMES[1]), (NAMES[0], NAMES[3]), (NAMES[0], NAMES[2]))
        rows.append((
            f"{1e3 * near_m:g} mm",
            *(order[i].partition(".")[2] for i in (0, -1)),
            *(f"{100 * shares[pair]:.1f} %" for pair in pairs),
        ))  # fmt: skip
    header = (
        "nearest plane",
        "greatest main effect",
        "least",
        "radius x wire radius",
        "radius x radial loops",
        "radius x axial loops",
    )
    return table("Fig 8 by the place of the grid, RMSE against the truth", header, rows)


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

"""Simulation-based calibration: truths drawn from the priors, readings by other code, posteriors by coilcal.

If posteriors are right, the rank of the truth among the draws is uniform, 90 % intervals hold it in 90 % of the repeats, and loop counts
given a probability p are true in a share p of the cases.

References: Talts et al., arXiv:1804.06788 (simulation-based calibration).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy import stats

from estimator import Rig, SamplerSettings, Session, calibrate, draw_truth, load_plan, load_rig
from estimator.readings.plan import observations_of
from tests.independent.readings import perfect_readings_T

ROOT = Path(__file__).resolve().parents[2]
NOISE_T = 20e-6
CURRENT_A = 3.0


def paper_rig() -> Rig:
    """The rig of the study: 10 free parameters, pose among them."""
    return load_rig(ROOT / "configs/paper_simulation.yaml")


def one_repeat(seed: int, target_ess: float = 600.0, fitted_rig: Rig | None = None) -> dict[str, Any]:
    """Calibrate one simulated visit to the paper's rig and compare with the truth.

    Args:
        seed: Of truth, noise and sampling.
        target_ess: Effective samples of every parameter.
        fitted_rig: What the fit believes; another rig than the true one breaks the calibration.
    """
    torch.set_num_threads(1)
    rig = paper_rig()
    plan = load_plan(ROOT / "configs/plans/paper_grid.yaml", rig)
    rng = np.random.default_rng([20, seed])
    observations = observations_of(plan, rig, rng).calibration
    truth = draw_truth(rig, seed) | {"hall.noise_T": NOISE_T}
    perfect_T = perfect_readings_T(truth, observations.motion["arm1"][:, :3].numpy(), CURRENT_A)
    noisy_T = perfect_T + NOISE_T * rng.normal(size=perfect_T.shape)
    session = Session(rig, observations.with_field(torch.from_numpy(noisy_T)), f"coverage study, seed {seed}")
    begin = time.perf_counter()
    settings = SamplerSettings(target_ess=target_ess, largest_rhat=1.05)
    calibration = calibrate(session, fitted_rig, seed=seed, settings=settings)
    record = calibration.summary()
    true_counts = (truth["coil1.axial_loops"], truth["coil1.radial_loops"])
    return {
        "seed": seed,
        "seconds": time.perf_counter() - begin,
        "is_converged": record["is_converged"],
        "rank": {name: _rank(draws, truth[name], rng) for name, draws in calibration.draws.items()},
        "counts": [
            [entry["probability"], (entry["axial"], entry["radial"]) == true_counts]
            for entry in record["loop_counts"]
        ],
    }


def coverage90(repeats: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Share of repeats whose central 90 % interval holds the truth, by parameter."""
    names = repeats[0]["rank"]
    return {name: float(np.mean([0.05 <= r["rank"][name] <= 0.95 for r in repeats])) for name in names}


def uniformity(repeats: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Probability of ranks at least this uneven if they were uniform (Kolmogorov-Smirnov), by parameter."""
    names = repeats[0]["rank"]
    return {name: float(stats.kstest([r["rank"][name] for r in repeats], "uniform").pvalue) for name in names}


def count_calibration(repeats: Sequence[Mapping[str, Any]], n_bins: int = 5) -> list[dict[str, float]]:
    """Stated probability of loop counts against how often they were true, in bins of the stated probability."""
    stated, is_true = np.array([pair for r in repeats for pair in r["counts"]], dtype=float).T
    rows = []
    for low, high in zip(np.linspace(0, 1, n_bins + 1)[:-1], np.linspace(0, 1, n_bins + 1)[1:], strict=True):
        mine = (stated > low) & (stated <= high)
        if mine.any():
            expected, sd = stated[mine].sum(), np.sqrt((stated[mine] * (1 - stated[mine])).sum())
            rows.append(
                {
                    "from": low,
                    "to": high,
                    "cases": int(mine.sum()),
                    "stated": expected / mine.sum(),
                    "true": is_true[mine].mean(),
                    "z": (is_true[mine].sum() - expected) / max(sd, 1e-9),
                }
            )
    return rows


def _rank(draws: np.ndarray, truth: float, rng: np.random.Generator) -> float:
    """Share of the posterior below the truth; ties, as whole counts have them, are broken at random."""
    return float(np.mean(draws < truth) + rng.uniform() * np.mean(np.isclose(draws, truth, rtol=1e-12)))

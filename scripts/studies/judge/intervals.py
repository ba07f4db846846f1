"""Whether intervals hold the truth: each beyond doubt, and all of a posterior together."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np
from scipy.stats import chi2

from estimator.readings.metrics import HALF_WIDTH_90
from scripts.studies.judge.handed_out import HandedOut
from scripts.studies.judge.truth import Truth

# One right interval in 16,000 misses by more: a study of a thousand statements has none by chance
FALSE_SD = 4.0
LEAST_JOINT = 1e-6  # of the distance of all numbers together, whose density is not quite normal
LEAST_COUNT = 1e-3  # probability of a true loop count below which a posterior excludes it


def miss_sd(value: float, median: float, ci90: tuple[float, float]) -> float:
    """Distance of a true value from a median, in standard deviations of that side of a 90 % interval."""
    half_width = ci90[1] - median if value > median else median - ci90[0]
    if half_width <= 0.0:
        return 0.0 if math.isclose(value, median, rel_tol=1e-9, abs_tol=1e-15) else math.inf
    return HALF_WIDTH_90 * abs(value - median) / half_width


def false_intervals(model: HandedOut, truth: Truth, ambiguous: Collection[str] = ()) -> dict[str, str]:
    """Numbers of the rig whose posterior excludes the truth, with words that say by how much; `together` where only all of them do.

    Args:
        model: With its draws.
        truth: What is true.
        ambiguous: Causes that are stated with others which they may be instead; their numbers are not judged.
    """
    names = [name for name in model.flat_draws if name.partition("[")[0] not in ambiguous]
    true_values = truth.numbers(names)
    draws = {name: values for name, values in model.flat_draws.items() if name in true_values}
    if not truth.is_clean:  # what a wrong model misses counts as noise of the readings
        draws = {name: values for name, values in draws.items() if not name.endswith(".noise_T")}
    excluded = {}
    for name, values in draws.items():
        true = true_values[name]
        if name.endswith("_loops") and bool((values == np.round(values)).all()):
            share = float((values == true).mean())
            if share < LEAST_COUNT:
                excluded[name] = f"{name} is {true:g}, which has probability {share:.2g}"
            continue
        low, median, high = np.quantile(values, [0.05, 0.5, 0.95])
        beyond = miss_sd(true, median, (low, high))
        if beyond > FALSE_SD and not values.min() <= true <= values.max():
            excluded[name] = f"{name} is {true:.6g}, {beyond:.1f} sd from {median:.6g}"
    if not excluded and (p := _joint(draws, true_values)) < LEAST_JOINT:
        excluded["together"] = f"all numbers together have probability {p:.1g}"
    return excluded


def missed_90(model: HandedOut, truth: Truth) -> tuple[int, int]:
    """How many 90 % intervals of numbers of the rig miss the truth, and their number."""
    true_values = truth.numbers(model.flat_draws)
    missed = 0
    for name, true in true_values.items():
        low, high = np.quantile(model.flat_draws[name], [0.05, 0.95])
        missed += not low <= true <= high
    return missed, len(true_values)


def _joint(draws: Mapping[str, np.ndarray], values: Mapping[str, float]) -> float:
    """Probability of a distance from the mean as large as that of the truth, were the density normal; noise and counts left aside."""
    names = [n for n in draws if not n.endswith(("noise_T", "_loops")) and draws[n].std() > 0.0]
    if len(names) < 2:
        return 1.0
    sample = np.stack([draws[name] for name in names])
    sd = sample.std(axis=1)
    away = (np.array([values[name] for name in names]) - sample.mean(axis=1)) / sd
    share, axes = np.linalg.eigh(np.corrcoef(sample))
    is_known = share > 1e-9 * share.max()
    squared = ((axes.T @ away)[is_known] ** 2 / share[is_known]).sum()
    return float(chi2.sf(squared, int(is_known.sum())))

"""How likely the printed numbers of Tables 8 to 10 are under each mistake of `residual_causes.py`.

Run `python -m scripts.paper.residual_ranking` after, or let it draw the twins. The density of the printed numbers under a cause is a
kernel estimate over its twins (approximate Bayesian computation): normal kernels, as wide in each number as Scott's rule says for the
robust spread of all twins. Two things are unknown in how the numbers were printed, and every combination is tried: whether the RMSE holds
eq 2's 1/2, and whether the relative errors of Table 10 are divided by the largest field or by the norm of all readings.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
from scipy.special import logsumexp

from scripts.paper import printed, residual_figure
from scripts.paper.residual_causes import CAUSES, N_TWINS, ROOT, START, Twin, twins
from scripts.paper.tables import table

READINGS = tuple(product((1.0, 0.5), ("largest field", "norm of all readings")))
N_VALIDATION = 512
N_BOOTSTRAP = 400
BEFORE_T, AFTER_T, MAX_BEFORE_T, MAX_AFTER_T, RELATIVE = (
    0.0043,
    0.0027,
    0.0092,
    0.0070,
    0.0260,
)  # 0.0074 is a misprint (errata)
PRINTED = np.array([*printed.CALIBRATED, *printed.CALIBRATED_POSE])
N_ERRORS = 4  # the first of the numbers below tell of errors, the others of parameters


def numbers_of(twin: Twin, factor: float, divisor: str) -> np.ndarray:
    """What a paper would print of a twin: four logarithms of ratios of errors, then the shifts of Table 8."""
    before_T, after_T = (factor * value for value in twin.rms_T)
    norm_T = np.sqrt(N_VALIDATION) * twin.field_rms_T
    divisor_T = twin.field_max_T if divisor == "largest field" else norm_T
    ratios = (after_T / before_T, twin.max_T[0] / before_T, twin.max_T[1] / after_T, after_T / divisor_T)
    return np.concatenate((np.log(ratios), shifts(np.array(twin.numbers))))


def shifts(numbers: np.ndarray) -> np.ndarray:
    """Radius and wire in mm, logarithms of the counts, translation in mm, rotation about x in rad: calibrated less measured."""
    counts = np.log(np.maximum(numbers[2:4], 0.5) / START[2:4])
    return np.concatenate((numbers[:2] - START[:2], counts, numbers[4:8] - START[4:8]))


def of_the_paper() -> np.ndarray:
    """The same numbers as the paper prints them."""
    ratios = (AFTER_T / BEFORE_T, MAX_BEFORE_T / BEFORE_T, MAX_AFTER_T / AFTER_T, RELATIVE)
    return np.concatenate((np.log(ratios), shifts(PRINTED)))


def log_kernels(drawn: np.ndarray, wanted: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Logarithm of each twin's kernel at the wanted numbers.

    Examples:
        >>> float(log_kernels(np.zeros((1, 1)), np.zeros(1), np.ones(1))[0])
        -0.919
    """
    scaled = (drawn - wanted) / width
    return -0.5 * (scaled**2).sum(-1) - np.log(width).sum() - 0.5 * len(width) * np.log(2.0 * np.pi)


def log_density(kernels: np.ndarray) -> tuple[float, float]:
    """Logarithm of the mean kernel, and its standard deviation by the bootstrap."""
    n = len(kernels)
    again = kernels[np.random.default_rng(0).integers(0, n, (N_BOOTSTRAP, n))]
    spread = float(np.std(logsumexp(again, axis=1)))
    return float(logsumexp(kernels) - np.log(n)), spread


def ranking(all_twins: Sequence[Twin]) -> str:
    """Log density of the errors, of the parameters, and of both, under each cause and its best reading of the tables."""
    wanted, results = of_the_paper(), {}
    pooled = np.stack([numbers_of(twin, *READINGS[0]) for twin in all_twins])
    spread = np.diff(np.quantile(pooled, (0.16, 0.84), axis=0), axis=0)[0] / 2.0
    n_twins = len(all_twins) // len(CAUSES)
    for cause in CAUSES:
        for reading in READINGS:
            drawn = np.stack([numbers_of(twin, *reading) for twin in all_twins if twin.cause == cause])
            results[cause, reading] = [
                log_density(
                    log_kernels(
                        drawn[:, part],
                        wanted[part],
                        spread[part] * n_twins ** (-1.0 / (4.0 + len(wanted[part]))),
                    )
                )
                for part in (slice(0, N_ERRORS), slice(N_ERRORS, None), slice(None))
            ]
    best = {cause: max(READINGS, key=lambda reading: results[cause, reading][0][0]) for cause in CAUSES}
    order = sorted(CAUSES, key=lambda cause: -results[cause, best[cause]][0][0])
    top = [max(results[cause, best[cause]][part][0] for cause in CAUSES) for part in range(3)]
    rows = [
        (
            cause,
            f"{'no' if best[cause][0] == 1.0 else 'yes'}, {best[cause][1]}",
            *(
                f"{value - most:+.1f} +- {sd:.1f}"
                for (value, sd), most in zip(results[cause, best[cause]], top, strict=True)
            ),
        )
        for cause in order
    ]
    header = ("cause", "1/2 in the RMSE, divisor", "errors (4 numbers)", "parameters (8)", "all 12")
    title = f"Log likelihood of the printed numbers less the best cause's, {n_twins} twins each"
    return "\n".join((table(title, header, rows), readings(results)))


def relative_to_rms() -> float:
    """Printed RMSE after the calibration over the rms field, if Table 10 divides by the norm of all readings."""
    return float(RELATIVE * np.sqrt(N_VALIDATION))


def readings(results: dict) -> str:
    """Which reading of the tables the errors ask for, all causes alike."""
    rows = []
    for reading in READINGS:
        density = logsumexp([results[cause, reading][0][0] for cause in CAUSES]) - np.log(len(CAUSES))
        rows.append(("no" if reading[0] == 1.0 else "yes", reading[1], f"{density:.1f}"))
    return table(
        "The errors under each reading, all causes alike", ("1/2", "divisor", "log likelihood"), rows
    )


def sizes(all_twins: Sequence[Twin]) -> str:
    """Median and central 68 % of what each cause leaves."""
    header = (
        "cause",
        "after / before",
        "largest / rms, after",
        "after / largest field",
        "after / rms field",
        "radius (mm)",
        "wire (mm)",
        "axial",
        "radial",
        "moved by (mm)",
        "turned by (rad)",
    )
    pose = PRINTED[4:7] - START[4:7]
    rows = [(
        "printed", f"{AFTER_T / BEFORE_T:.2f}", f"{MAX_AFTER_T / AFTER_T:.1f}", f"{RELATIVE:.3f} or", f"or {relative_to_rms():.2f}",
        *(f"{value:g}" for value in PRINTED[:4]), f"{np.linalg.norm(pose):.1f}", f"{PRINTED[7] - START[7]:.2f}",
    )]  # fmt: skip
    for cause in CAUSES:
        columns = np.array([
            (
                twin.rms_T[1] / twin.rms_T[0], twin.max_T[1] / twin.rms_T[1], twin.rms_T[1] / twin.field_max_T,
                twin.rms_T[1] / twin.field_rms_T, *twin.numbers[:4],
                np.linalg.norm(np.array(twin.numbers[4:7]) - START[4:7]), twin.numbers[7] - START[7],
            )
            for twin in all_twins if twin.cause == cause
        ])  # fmt: skip
        low, middle, high = np.quantile(columns, (0.16, 0.5, 0.84), axis=0)
        rows.append(
            (cause, *(f"{m:.3g} ({a:.3g}, {b:.3g})" for a, m, b in zip(low, middle, high, strict=True)))
        )
    return table("What each mistake leaves: median and central 68 %, vector rms", header, rows)


def study(out: Path, processes: int = 1) -> str:
    """Sizes, ranking and the figure; twins that are missing in the folder are made."""
    all_twins = twins(out / "residual_causes.jsonl", N_TWINS, processes)
    picture = residual_figure.drawn(all_twins, AFTER_T / BEFORE_T, RELATIVE, relative_to_rms())
    picture.savefig(out / "residual_causes.png", dpi=90, bbox_inches="tight")
    return "\n".join((ranking(all_twins), sizes(all_twins)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "out/paper")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    print(study(options.out, options.processes))


if __name__ == "__main__":
    main()

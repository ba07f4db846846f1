"""Loop and winding fields per second at the same points by coilcal, SciPy and magpylib, each with its largest difference."""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import magpylib
import numpy as np
import torch
from scipy.special import ellipe, ellipk

from estimator.benchmarks.fields import (
    N_AXIAL,
    N_RADIAL,
    PITCH_M,
    RADIUS_M,
    Field,
    by_rule,
    loops_of_paper,
    magpylib_loops,
    over_loops,
    winding_of,
)
from estimator.field.loop import loop_field
from estimator.field.winding import Winding, exact_rule, winding_field_per_ampere
from estimator.field.winding_shape import DEFAULT_TOLERANCE, choose_rule
from estimator.units import MU0_T_M_PER_A

ALL_DIGITS = 1e-13  # tolerance of a rule that is as exact as the full sum


def fields(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    n_points, n_axial, n_radial = (40, 6, 3) if options.tiny else (500, N_AXIAL, N_RADIAL)
    rng = np.random.default_rng(options.seed)

    def points(number: int) -> np.ndarray:
        return rng.uniform([-0.05, -0.05, 0.015], [0.05, 0.05, 0.065], (number, 3))

    return {
        f"one loop, {100 * n_points} points": compared(loop_methods(), points(100 * n_points), options),
        f"winding of {n_axial} x {n_radial} loops, {n_points} points": compared(
            winding_methods(n_axial, n_radial, points(n_points)),
            points(n_points),
            options,
        ),
    }


def compared(methods: dict[str, Field], points_m: np.ndarray, options: argparse.Namespace) -> dict[str, Any]:
    """Median, smallest and largest number of fields per second, and the largest difference from the first method relative to |B|."""
    parts = np.array_split(points_m, options.threads)
    reference = next(iter(methods.values()))(points_m)
    times: dict[str, list[float]] = {name: [] for name in methods}
    rows: dict[str, Any] = {}
    with ThreadPoolExecutor(options.threads) as pool:
        for name, method in methods.items():  # also compiles, and fills caches
            field = np.concatenate(list(pool.map(method, parts)))
            difference = np.linalg.norm(field - reference, axis=1) / np.linalg.norm(reference, axis=1)
            rows[name] = {"largest_difference": float(difference.max())}
        for _ in range(options.repeats):  # in turn, so that a busy moment of the machine affects all methods
            for name, method in methods.items():
                begin = time.perf_counter()
                list(pool.map(method, parts))
                times[name].append(time.perf_counter() - begin)
    for name, seconds in times.items():
        rows[name]["per_second"] = [
            float(len(points_m) / s) for s in (np.median(seconds), max(seconds), min(seconds))
        ]
    return rows


def loop_methods() -> dict[str, Field]:
    circle = magpylib.current.Circle(diameter=2.0 * RADIUS_M, current=1.0)
    one = torch.ones((), dtype=torch.float64)
    # A winding of one loop, which lies at z = -PITCH_M / 2.
    single_loop = Winding((RADIUS_M + 0.5 * PITCH_M) * one, one, one, PITCH_M * one, PITCH_M * one)

    def by_torch(points_m: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return loop_field(torch.from_numpy(points_m), RADIUS_M * one).numpy()

    def coilcal(points_m: np.ndarray) -> np.ndarray:
        lowered = torch.from_numpy(points_m - [0.0, 0.0, 0.5 * PITCH_M])
        return winding_field_per_ampere(lowered, single_loop, exact_rule(single_loop, lowered)).numpy()

    return {
        "coilcal": coilcal,
        "coilcal, by torch": by_torch,
        "SciPy ellipk, ellipe, eq 4": lambda points_m: scipy_loops(points_m, RADIUS_M),
        "magpylib core": lambda points_m: magpylib_loops(points_m, RADIUS_M),
        "magpylib Circle.getH": lambda points_m: MU0_T_M_PER_A * circle.getH(points_m),
    }


def winding_methods(n_axial: int, n_radial: int, near_m: np.ndarray) -> dict[str, Field]:
    """Every method for the same winding; the rules are chosen for the region of the points `near_m`."""
    winding = winding_of(n_axial, n_radial)
    heights_m, radii_m = loops_of_paper(n_axial, n_radial)
    circles = [
        magpylib.current.Circle(diameter=2.0 * radius_m, current=1.0, position=(0.0, 0.0, height_m))
        for height_m, radius_m in zip(heights_m, radii_m, strict=True)
    ]
    collection = magpylib.Collection(circles)
    near = torch.from_numpy(near_m)
    rules = {
        "full sum": exact_rule(winding, near),
        "rule as exact": choose_rule(winding, near, ALL_DIGITS),
        f"rule to {DEFAULT_TOLERANCE:.0e}": choose_rule(winding, near),
    }

    methods = {
        f"coilcal, {name}, {rule.axial_nodes} x {rule.radial_nodes}": by_rule(winding, rule)
        for name, rule in rules.items()
    }
    return methods | {
        "SciPy ellipk, ellipe, eq 4": over_loops(scipy_loops, heights_m, radii_m),
        "magpylib core": over_loops(magpylib_loops, heights_m, radii_m),
        "magpylib Collection.getH": lambda points_m: MU0_T_M_PER_A * collection.getH(points_m),
    }


def scipy_loops(points_m: np.ndarray, a_m: np.ndarray | float) -> np.ndarray:
    """Osinde et al., eq 4, as printed."""
    x, y, z = points_m.T
    rho = np.hypot(x, y)
    alpha2, beta2 = (a_m - rho) ** 2 + z**2, (a_m + rho) ** 2 + z**2
    m = 1.0 - alpha2 / beta2
    k, e = ellipk(m), ellipe(m)
    common = MU0_T_M_PER_A / (2.0 * np.pi * np.sqrt(beta2))
    radial = common * z / rho**2 * (-k + (a_m**2 + rho**2 + z**2) / alpha2 * e)
    axial = common * (k + (a_m**2 - rho**2 - z**2) / alpha2 * e)
    return np.stack((radial * x, radial * y, axial), axis=1)

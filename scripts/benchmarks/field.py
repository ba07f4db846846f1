"""Loop and winding fields per second at the same points by coilcal, SciPy and magpylib, each with its largest difference."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import magpylib
import numpy as np
import torch
from scipy.special import ellipe, ellipk

from estimator.field.loop import loop_field
from estimator.field.winding import (
    DEFAULT_TOLERANCE,
    Rule,
    Winding,
    choose_rule,
    exact_rule,
    winding_field_per_ampere,
)
from estimator.units import MU0_T_M_PER_A

RADIUS_M, N_AXIAL, N_RADIAL, PITCH_M = 0.051, 48, 25, 0.98e-3  # the paper's simulated coil
ALL_DIGITS = 1e-13  # tolerance of a rule that is as exact as the full sum
LOOPS_PER_CALL = 16_384  # of NumPy codes: arrays this long stay in the cache
Field = Callable[[np.ndarray], np.ndarray]


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
    one = torch.ones((), dtype=torch.float64)
    winding = Winding(RADIUS_M * one, n_axial * one, n_radial * one, PITCH_M * one, PITCH_M * one)
    heights_m = np.repeat(-PITCH_M * (np.arange(n_axial) + 0.5), n_radial)
    radii_m = np.tile(RADIUS_M - PITCH_M * (np.arange(n_radial) + 0.5), n_axial)
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

    def coilcal(rule: Rule) -> Field:
        return lambda points_m: winding_field_per_ampere(torch.from_numpy(points_m), winding, rule).numpy()

    def in_pieces(loops: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Field:
        def field(points_m: np.ndarray) -> np.ndarray:
            pieces = np.array_split(points_m, max(1, len(points_m) * len(radii_m) // LOOPS_PER_CALL))
            return np.concatenate([summed(loops, piece) for piece in pieces])

        return field

    def summed(loops: Callable[[np.ndarray, np.ndarray], np.ndarray], piece: np.ndarray) -> np.ndarray:
        relative = piece[:, None, :] - np.stack((0.0 * heights_m, 0.0 * heights_m, heights_m), axis=-1)
        by_loop = loops(relative.reshape(-1, 3), np.tile(radii_m, len(piece)))
        return by_loop.reshape(len(piece), -1, 3).sum(axis=1)

    methods = {
        f"coilcal, {name}, {rule.axial_nodes} x {rule.radial_nodes}": coilcal(rule)
        for name, rule in rules.items()
    }
    return methods | {
        "SciPy ellipk, ellipe, eq 4": in_pieces(scipy_loops),
        "magpylib core": in_pieces(magpylib_loops),
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


def magpylib_loops(points_m: np.ndarray, a_m: np.ndarray | float) -> np.ndarray:
    x, y, z = points_m.T
    rho = np.hypot(x, y)
    radii_m = np.broadcast_to(np.asarray(a_m), rho.shape)
    h_rho, _, h_z = magpylib.core.current_circle_Hfield(r0=radii_m, r=rho, z=z, i0=np.ones(len(rho)))
    return MU0_T_M_PER_A * np.stack((h_rho * x / rho, h_rho * y / rho, h_z), axis=1)

"""Field evaluations and first derivatives a second of the paper's winding, beside magpylib at the same points."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import torch

from estimator.benchmarks.rows import Row, by_turns, with_ratios
from estimator.field.node_sum import SumMode
from estimator.field.winding import Winding, exact_rule, winding_field_per_ampere
from estimator.field.winding_shape import Rule, choose_rule
from estimator.units import MU0_T_M_PER_A

RADIUS_M, N_AXIAL, N_RADIAL, PITCH_M = 0.051, 48, 25, 0.98e-3  # the paper's simulated coil
LOOPS_PER_CALL = 16_384  # of NumPy codes: arrays this long stay in the cache
LEAST_S = 0.2  # of calls in a repeat: one takes a millisecond, which any other process lengthens
STEP_M = 1e-5  # of differences, where a library has no derivatives
MAGPYLIB = "magpylib, every loop"
DIFFERENCES = "magpylib, central differences"
Field = Callable[[np.ndarray], np.ndarray]


def has_magpylib() -> bool:
    """Whether magpylib, the peer, is installed."""
    return find_spec("magpylib") is not None


def field_rows(n_points: int, repeats: int, seed: int) -> list[Row]:
    """Fields of the winding a second, on one core."""
    points_m, winding, near = points_of(n_points, seed), winding_of(), torch.from_numpy(points_of(500, seed))
    rule, full = choose_rule(winding, near), exact_rule(winding, near)
    methods = {"coilcal, usual rule": by_rule(winding, rule), "coilcal, every loop": by_rule(winding, full)}
    if has_magpylib():
        methods[MAGPYLIB] = over_loops(magpylib_loops, *loops_of_paper(N_AXIAL, N_RADIAL))
    return _rows(methods, points_m, "fields/s", repeats, MAGPYLIB)


def derivative_rows(n_points: int, repeats: int, seed: int) -> list[Row]:
    """Fields with their nine derivatives by position a second; magpylib leaves derivatives to its user."""
    points_m, winding = points_of(n_points, seed), winding_of()
    rule = choose_rule(winding, torch.from_numpy(points_of(500, seed)))
    methods: dict[str, Field] = {"coilcal, usual rule": lambda at_m: gradient(at_m, winding, rule)}
    if has_magpylib():
        field = over_loops(magpylib_loops, *loops_of_paper(N_AXIAL, N_RADIAL))
        methods[DIFFERENCES] = lambda at_m: differences(field, at_m)
    return _rows(methods, points_m, "fields with derivatives/s", repeats, DIFFERENCES)


def _rows(methods: dict[str, Field], points_m: np.ndarray, unit: str, repeats: int, peer: str) -> list[Row]:
    calls = {name: lambda method=method: method(points_m) for name, method in methods.items()}
    seconds = by_turns(calls, repeats, LEAST_S)
    rows = [
        Row(name, unit, tuple(len(points_m) / taken_s for taken_s in values))
        for name, values in seconds.items()
    ]
    return with_ratios(rows, peer)


def points_of(number: int, seed: int) -> np.ndarray:
    """Points in front of the coil, in its frame."""
    return np.random.default_rng(seed).uniform([-0.05, -0.05, 0.015], [0.05, 0.05, 0.065], (number, 3))


def winding_of(n_axial: int = N_AXIAL, n_radial: int = N_RADIAL) -> Winding:
    """The paper's winding, or one of other numbers of loops."""
    ones = torch.ones((), dtype=torch.float64)
    return Winding(RADIUS_M * ones, n_axial * ones, n_radial * ones, PITCH_M * ones, PITCH_M * ones)


def loops_of_paper(n_axial: int, n_radial: int) -> tuple[np.ndarray, np.ndarray]:
    """Height and radius of every loop of that winding, in m."""
    heights_m = np.repeat(-PITCH_M * (np.arange(n_axial) + 0.5), n_radial)
    radii_m = np.tile(RADIUS_M - PITCH_M * (np.arange(n_radial) + 0.5), n_axial)
    return heights_m, radii_m


def by_rule(winding: Winding, rule: Rule) -> Field:
    """Fields by coilcal."""
    return lambda points_m: winding_field_per_ampere(torch.from_numpy(points_m), winding, rule).numpy()


def gradient(points_m: np.ndarray, winding: Winding, rule: Rule) -> np.ndarray:
    """Derivatives by position, by coilcal: a backward pass for each component of the field."""
    points = torch.from_numpy(points_m).requires_grad_()
    field = winding_field_per_ampere(points, winding, rule, SumMode.FIRST_ORDER)
    rows = [torch.autograd.grad(field[:, i].sum(), points, retain_graph=True)[0] for i in range(3)]
    return torch.stack(rows, dim=1).numpy()


def differences(field: Field, points_m: np.ndarray) -> np.ndarray:
    """Derivatives by position, from six more fields."""
    steps_m = STEP_M * np.eye(3)
    field(points_m)  # which a caller wants too
    columns = [(field(points_m + step) - field(points_m - step)) / (2.0 * STEP_M) for step in steps_m]
    return np.stack(columns, axis=-1)


def over_loops(
    loops: Callable[[np.ndarray, np.ndarray], np.ndarray], heights_m: np.ndarray, radii_m: np.ndarray
) -> Field:
    """Fields as a sum of single loops, for codes that have no windings; in pieces that stay in the cache."""

    def field(points_m: np.ndarray) -> np.ndarray:
        pieces = np.array_split(points_m, max(1, len(points_m) * len(radii_m) // LOOPS_PER_CALL))
        return np.concatenate([summed(piece) for piece in pieces])

    def summed(piece: np.ndarray) -> np.ndarray:
        relative = piece[:, None, :] - np.stack((0.0 * heights_m, 0.0 * heights_m, heights_m), axis=-1)
        by_loop = loops(relative.reshape(-1, 3), np.tile(radii_m, len(piece)))
        return by_loop.reshape(len(piece), -1, 3).sum(axis=1)

    return field


def magpylib_loops(points_m: np.ndarray, a_m: np.ndarray | float) -> np.ndarray:
    """Fields of loops of one ampere by magpylib's core, the fastest way into it."""
    import magpylib

    x, y, z = points_m.T
    rho = np.hypot(x, y)
    radii_m = np.broadcast_to(np.asarray(a_m), rho.shape)
    h_rho, _, h_z = magpylib.core.current_circle_Hfield(r0=radii_m, r=rho, z=z, i0=np.ones(len(rho)))
    return MU0_T_M_PER_A * np.stack((h_rho * x / rho, h_rho * y / rho, h_z), axis=1)

"""Fields and fits on each device here, in double and single precision.

The peak is what a product of large matrices reaches in the same precision. The operations of one loop at one point are counted from a call:
each number that torch makes is one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from estimator import draw_truth, load_plan, load_rig, simulate
from estimator.batching.stacked import stacked_fits
from estimator.benchmarks.machine import processor
from estimator.field.winding import Winding, winding_field_per_ampere
from estimator.field.winding_shape import Rule
from estimator.inference.positive_definite import inverse

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PRECISIONS = {"double": torch.float64, "single": torch.float32}
DISTANCES_M = (0.002, 0.01, 0.05, 0.2, 1.0)
RULE = Rule(8, 8, 5)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--points", type=int, default=200_000, help="on a graphics processor ten times as many"
    )
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    devices = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
    print(f"{processor()}, one thread" + (f"; {torch.cuda.get_device_name()}" if "cuda" in devices else ""))
    if "cuda" not in devices:
        print("no graphics processor that torch can use: numbers of the processor only")
    show_errors()
    n_operations = operations()
    for device in devices:
        for name, dtype in PRECISIONS.items():
            show_field(device, name, dtype, options, n_operations)
    show_fits(devices, options)


def winding(device: str, dtype: torch.dtype) -> Winding:
    """The simulated coil of the paper."""
    return Winding(*torch.tensor([0.051, 48.0, 25.0, 0.98e-3, 0.98e-3], dtype=dtype, device=device))


def show_errors() -> None:
    """Error of single precision by distance, in front of the winding."""
    outer_m = 0.051
    for distance_m in DISTANCES_M:
        rho_m = torch.linspace(0.0, outer_m, 500, dtype=torch.float64)
        points_m = torch.stack((rho_m, 0.0 * rho_m, torch.full_like(rho_m, distance_m)), dim=-1)
        double = winding_field_per_ampere(points_m, winding("cpu", torch.float64), RULE)
        single = winding_field_per_ampere(points_m.float(), winding("cpu", torch.float32), RULE)
        error = (single - double).norm(dim=-1) / double.norm(dim=-1)
        print(
            f"error of single precision {distance_m * 1e3:g} mm in front: median {error.median():.1e}, largest {error.max():.1e} of |B|"
        )


class _Counted(TorchDispatchMode):
    """Counts the numbers that operations make."""

    n = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        made = func(*args, **(kwargs or {}))
        if isinstance(made, torch.Tensor) and not func.is_view:
            self.n += made.numel()
        return made


def operations() -> float:
    """Operations of one loop at one point."""
    points_m = torch.rand(4096, 3) + 0.1
    with _Counted() as counted:
        winding_field_per_ampere(points_m, winding("cpu", torch.float32), RULE)
    return counted.n / (len(points_m) * RULE.axial_nodes * RULE.radial_nodes)


def show_field(
    device: str, name: str, dtype: torch.dtype, options: argparse.Namespace, n_operations: float
) -> None:
    n_points = options.points * (10 if device == "cuda" else 1)
    points_m = torch.rand(n_points, 3, dtype=dtype, device=device) + 0.1
    coil = winding(device, dtype)
    seconds = timed(lambda: winding_field_per_ampere(points_m, coil, RULE), device, options.repeats)
    per_second = n_points * RULE.axial_nodes * RULE.radial_nodes / seconds
    size = 4096 if device == "cuda" else 512
    matrix = torch.rand(size, size, dtype=dtype, device=device)
    peak = 2.0 * size**3 / timed(lambda: matrix @ matrix, device, options.repeats)
    print(
        f"{device}, {name}: {per_second / 1e6:.3g} million loops and points a second, "
        f"{per_second * n_operations / peak:.1%} of a peak of {peak / 1e9:.3g} GFLOP/s at {n_operations:.0f} operations each"
    )


def show_fits(devices: list[str], options: argparse.Namespace) -> None:
    """Fits of sessions, stacked, in processor seconds on the processor."""
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    plan = load_plan(CONFIGS / "plans/paper_grid.yaml", rig)
    sessions = [simulate(rig, plan, draw_truth(rig, seed), seed=seed) for seed in range(options.sessions)]
    reference = None
    for device in devices:
        for name, dtype in PRECISIONS.items():
            readings = [session.to(device, dtype) for session in sessions]
            fits: list[Any] = []

            def work(readings: Any = readings, fits: list[Any] = fits) -> None:
                fits[:] = stacked_fits(rig, readings, range(len(readings)), 0)

            seconds = timed(work, device, 1)
            vectors = torch.cat([fit.vector for _, fit in fits]).cpu()
            print(
                f"{device}, {name}: {len(sessions) / seconds:.3g} posteriors a second, {len(sessions)} sessions",
                end="",
            )
            if reference is None:
                reference = vectors, torch.cat([inverse(fit.precision) for _, fit in fits]).cpu()
                print()
                continue
            sd = reference[1].diagonal(dim1=-2, dim2=-1).sqrt()
            off = ((vectors - reference[0]).abs() / sd).amax(-1)
            print(
                f"; off the double precision of the processor by {off.median():.1e} sd (median), {off.max():.1e} (largest)"
            )


def timed(work: Callable[[], object], device: str, repeats: int) -> float:
    """Median time of a call: of the processor where it works alone, of the clock where it waits for a graphics processor."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    seconds = []
    for _ in range(repeats + (repeats > 1)):
        begin = clock()
        work()
        if device == "cuda":
            torch.cuda.synchronize()
        seconds.append(clock() - begin)
    return median(seconds[-repeats:])


if __name__ == "__main__":
    main()

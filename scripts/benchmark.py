"""Speed beside magpylib, SciPy and plain emcee, in one run on one machine; `make bench` runs it.

Times are medians over repeats. Look at the ratios: absolute numbers belong to the machine that is printed with them.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import emcee
import magpylib
import numpy as np
import scipy
import torch
from scipy.special import ellipe, ellipk

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from estimator import SamplerSettings, load_plan, load_rig, simulate
from estimator.chain import Chain
from estimator.coordinates import Coordinates
from estimator.field.winding import Winding, exact_rule, winding_field_per_ampere
from estimator.inference.convergence import convergence
from estimator.inference.ensemble import reported, sample
from estimator.inference.lattice import count_mixture
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import point_estimate
from estimator.units import MU0_T_M_PER_A

WINDING = (0.051, 48, 25, 0.98e-3)  # external radius, axial and radial loops, pitch
SEED = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--ess", type=float, default=10_000.0)
    parser.add_argument("--stretch-steps", type=int, default=3000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"{platform.processor() or platform.machine()}, {processor()}, one thread; seed {SEED}, {options.repeats} repeats"
    )
    packages = {"torch": torch, "numpy": np, "scipy": scipy, "emcee": emcee, "magpylib": magpylib}
    print(", ".join(f"{name} {module.__version__}" for name, module in packages.items()))
    result = {"fields": fields(options.repeats), "sampling": sampling(options.ess, options.stretch_steps)}
    result["peak_memory_GB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"\npeak memory of this process: {result['peak_memory_GB']:.2f} GB")
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


def processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    return next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown processor"
    )


def fields(repeats: int) -> dict[str, float]:
    """Full sums over 1200 loops at 500 points: time per loop field, and how far the results differ."""
    radius_m, n_axial, n_radial, pitch_m = WINDING
    points_m = np.random.default_rng(SEED).uniform([-0.05, -0.05, 0.015], [0.05, 0.05, 0.065], (500, 3))
    heights_m = -pitch_m * (np.arange(n_axial) + 0.5)
    radii_m = radius_m - pitch_m * (np.arange(n_radial) + 0.5)
    torch_points = torch.from_numpy(points_m)
    one = torch.ones((), dtype=torch.float64)
    winding = Winding(radius_m * one, n_axial * one, n_radial * one, pitch_m * one, pitch_m * one)
    rule = exact_rule(winding, torch_points)

    def coilcal(is_compiled: bool) -> np.ndarray:
        with torch.no_grad():
            return winding_field_per_ampere(torch_points, winding, rule, is_compiled).numpy()

    def by_loops(loop: Callable[[np.ndarray, float], np.ndarray]) -> np.ndarray:
        return sum(loop(points_m - [0.0, 0.0, height_m], a_m) for height_m in heights_m for a_m in radii_m)

    methods: dict[str, Callable[[], np.ndarray]] = {
        "coilcal, compiled": lambda: coilcal(True),
        "coilcal, eager": lambda: coilcal(False),
        "SciPy ellipk/ellipe, eq 4": lambda: by_loops(scipy_loop),
        "magpylib core": lambda: by_loops(magpylib_loop),
    }
    n = len(points_m) * n_axial * n_radial
    reference = coilcal(False)
    print(f"\n{'field of loops':28} {'ns a loop':>10} {'ratio to magpylib':>18} {'largest difference':>19}")
    rows = {}
    for name, method in methods.items():
        difference = np.linalg.norm(method() - reference, axis=1) / np.linalg.norm(reference, axis=1)
        rows[name] = (median_time(method, repeats) / n * 1e9, difference.max())
    for name, (time_ns, difference) in rows.items():
        print(f"{name:28} {time_ns:10.1f} {rows['magpylib core'][0] / time_ns:18.1f} {difference:19.1e}")
    return {name: float(time_ns) for name, (time_ns, _) in rows.items()}


def scipy_loop(points_m: np.ndarray, a_m: float) -> np.ndarray:
    x, y, z = points_m.T
    rho = np.hypot(x, y)
    alpha2, beta2 = (a_m - rho) ** 2 + z**2, (a_m + rho) ** 2 + z**2
    m = 1.0 - alpha2 / beta2
    k, e = ellipk(m), ellipe(m)
    common = MU0_T_M_PER_A / (2.0 * np.pi * np.sqrt(beta2))
    b_rho = common * z / rho * (-k + (a_m**2 + rho**2 + z**2) / alpha2 * e)
    return np.stack(
        (b_rho * x / rho, b_rho * y / rho, common * (k + (a_m**2 - rho**2 - z**2) / alpha2 * e)), axis=1
    )


def magpylib_loop(points_m: np.ndarray, a_m: float) -> np.ndarray:
    x, y, z = points_m.T
    rho = np.hypot(x, y)
    n = len(rho)
    h_rho, _, h_z = magpylib.core.current_circle_Hfield(r0=np.full(n, a_m), r=rho, z=z, i0=np.ones(n))
    return MU0_T_M_PER_A * np.stack((h_rho * x / rho, h_rho * y / rho, h_z), axis=1)


def sampling(target_ess: float, stretch_steps: int) -> dict[str, float]:
    """125 readings, 10 parameters, 20 uT: effective samples a second of the slowest parameter."""
    rig = load_rig(ROOT / "configs/paper_simulation.yaml")
    plan = load_plan(ROOT / "configs/plans/paper_grid.yaml", rig)
    truth = json.loads((ROOT / "configs/truth/paper_simulation.json").read_text())
    observations = simulate(rig, plan, truth, SEED).calibration
    begin = time.perf_counter()
    chain = Chain.build(rig, observations)
    continuous = LogPosterior(Coordinates(rig), chain, observations)
    estimate = point_estimate(continuous, observations, SEED)
    lattice = LogPosterior(Coordinates(rig, integer_counts=True), chain, observations)
    on_lattice = count_mixture(continuous, lattice, estimate.fit, np.random.default_rng(SEED))
    if on_lattice is None:
        raise RuntimeError("the loop counts of this session are too uncertain for a table")
    set_up_s = time.perf_counter() - begin
    on_reals = count_mixture(continuous, continuous, estimate.fit, np.random.default_rng(SEED))
    assert on_reals is not None
    print(
        f"\n{len(observations)} readings, {lattice.coordinates.n} parameters; set-up (point estimate, Laplace) {set_up_s:.1f} s"
    )
    print(f"{'sampler':44} {'s':>7} {'evaluations':>12} {'smallest ESS':>13} {'ESS/s':>8} {'R-hat':>7}")
    rates = {"set_up_s": set_up_s}
    for name, posterior, mixture in (
        ("coilcal, whole loop counts", lattice, on_lattice),
        ("coilcal, real-valued counts", continuous, on_reals),
    ):
        begin = time.perf_counter()
        samples = sample(posterior, mixture, SamplerSettings(target_ess=target_ess, seed=SEED))
        elapsed = time.perf_counter() - begin
        n_evaluations = samples.n_steps * samples.log_prob.shape[1]
        ess, rhat = samples.convergence.smallest_ess, samples.convergence.largest_rhat
        rates[name] = ess / elapsed
        print(f"{name:44} {elapsed:7.1f} {n_evaluations:12d} {ess:13.0f} {rates[name]:8.0f} {rhat:7.4f}")
    rates["stretch"] = stretch(continuous, estimate.vector, estimate.fit.precision[0], stretch_steps)
    print(
        f"coilcal over plain emcee, same posterior: {rates['coilcal, real-valued counts'] / rates['stretch']:.0f} times"
    )
    return rates


def stretch(posterior: LogPosterior, centre: torch.Tensor, precision: torch.Tensor, steps: int) -> float:
    """Plain emcee with its default move on the same kernel, started in the posterior; the first quarter is dropped."""

    def log_prob(vectors: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return posterior(torch.from_numpy(vectors)).numpy()

    random = np.random.default_rng(SEED)
    n, n_walkers = len(centre), 32
    start = random.multivariate_normal(centre.numpy(), torch.linalg.inv(precision).numpy(), n_walkers)
    sampler = emcee.EnsembleSampler(n_walkers, n, log_prob, vectorize=True)
    begin = time.perf_counter()
    sampler.run_mcmc(start, steps, skip_initial_state_check=True)
    elapsed = time.perf_counter() - begin
    result = convergence(reported(posterior.coordinates, sampler.get_chain(discard=steps // 4)))
    rate = result.smallest_ess / (0.75 * elapsed)
    print(
        f"{'emcee, stretch move, real-valued counts':44} {elapsed:7.1f} {steps * n_walkers:12d} {result.smallest_ess:13.0f} "
        f"{rate:8.1f} {result.largest_rhat:7.4f}"
    )
    return rate


def median_time(function: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


if __name__ == "__main__":
    main()

"""A point estimate, and effective samples a second of coilcal's sampler beside plain emcee on the same density."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
import torch

from estimator.benchmarks.rows import Row, by_turns, with_ratios
from estimator.benchmarks.sessions import grid_readings
from estimator.inference.convergence import Convergence, convergence
from estimator.inference.ensemble import BURN_IN_SHARE, SamplerSettings, reported_parameters, sample
from estimator.inference.lattice import CountMixture, count_mixture
from estimator.inference.levenberg_marquardt import Optimum
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import point_estimate
from estimator.inference.positive_definite import inverse
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Coordinates

N_WALKERS = 32
PLAIN = "emcee's stretch move, real loop counts"


def estimate_rows(n: int, repeats: int, seed: int) -> list[Row]:
    """Seconds of one point estimate of n x n x n readings, model included."""
    rig, readings = grid_readings(n, seed)

    def estimate() -> None:
        posterior = LogPosterior(Coordinates(rig), MeasurementModel.build(rig, readings), readings)
        point_estimate(posterior, readings, seed)

    name = f"point estimate, {len(readings)} readings"
    return [Row(name, "s", by_turns({name: estimate}, repeats)[name])]


def sampling_rows(n: int, target_ess: float, stretch_steps: int, repeats: int, seed: int) -> list[Row]:
    """Effective samples a second of the slowest parameter, burn-in and diagnostics included, set-up not.

    coilcal samples whole loop counts, as `coilcal calibrate` does, and real ones, which is all that the stretch move can.
    """
    rig, readings = grid_readings(n, seed)
    model = MeasurementModel.build(rig, readings)
    continuous = LogPosterior(Coordinates(rig), model, readings)
    fit = point_estimate(continuous, readings, seed).fit
    with torch.no_grad():
        model = model.choose_rules(continuous.coordinates.values(fit.vector[0]))
    continuous = LogPosterior(continuous.coordinates, model, readings)
    lattice = LogPosterior(Coordinates(rig, integer_counts=True), model, readings)

    def coilcal(posterior: LogPosterior) -> Callable[[int], Convergence]:
        mixture = mixture_of(continuous, posterior, fit, seed)

        def run(run_seed: int) -> Convergence:
            settings = SamplerSettings(N_WALKERS, target_ess=target_ess, seed=run_seed)
            return sample(posterior, mixture, settings).convergence

        return run

    runs: dict[str, Callable[[int], Convergence]] = {
        "coilcal, whole loop counts": coilcal(lattice),
        "coilcal, real loop counts": coilcal(continuous),
        PLAIN: lambda run_seed: stretch(continuous, fit, stretch_steps, N_WALKERS, run_seed)[1],
    }
    rates: dict[str, list[float]] = {name: [] for name in runs}
    rhats: dict[str, float] = dict.fromkeys(runs, 0.0)
    for i in range(repeats):
        for name, run in runs.items():
            begin_s = time.perf_counter()
            reached = run(seed + i)
            rates[name].append(reached.smallest_ess / (time.perf_counter() - begin_s))
            rhats[name] = max(rhats[name], float(reached.largest_rhat))
    rows = [
        Row(name, "effective samples/s", tuple(values), extra={"largest_rhat": rhats[name]})
        for name, values in rates.items()
    ]
    return with_ratios(rows, PLAIN)


def mixture_of(continuous: LogPosterior, target: LogPosterior, fit: Optimum, seed: int) -> CountMixture:
    """The proposal of coilcal's moves."""
    mixture = count_mixture(continuous, target, fit, np.random.default_rng(seed))
    if mixture is None:
        raise RuntimeError("the loop counts of this session are too uncertain for a table")
    return mixture


def stretch(
    posterior: LogPosterior, fit: Optimum, steps: int, n_walkers: int, seed: int
) -> tuple[int, Convergence]:
    """Plain emcee with its default move on the same kernel, started in the posterior: number of evaluations, and convergence."""

    def log_prob(vectors: np.ndarray) -> Any:
        with torch.no_grad():
            return posterior(torch.from_numpy(vectors)).numpy()

    random = np.random.RandomState(seed)
    start = random.multivariate_normal(fit.vector[0].numpy(), inverse(fit.precision)[0].numpy(), n_walkers)
    sampler = emcee.EnsembleSampler(n_walkers, start.shape[1], log_prob, vectorize=True)
    state = emcee.State(start, random_state=random.get_state())
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    chain = sampler.get_chain(discard=int(BURN_IN_SHARE * steps))
    return steps * n_walkers, convergence(reported_parameters(posterior.coordinates, chain))

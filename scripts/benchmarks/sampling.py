"""Effective samples per second of the slowest parameter on the paper's simulated session: 125 readings, 10 parameters, 20 uT.

coilcal samples whole loop counts. emcee's stretch move and NUTS cannot: they sample the same readings and priors with real-valued counts,
as does coilcal a second time for comparison.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import emcee
import numpy as np
import torch

from estimator import SamplerSettings, load_plan, load_rig, simulate
from estimator.inference.convergence import Convergence, convergence
from estimator.inference.ensemble import BURN_IN_SHARE, reported_parameters, sample
from estimator.inference.laplace import covariance
from estimator.inference.lattice import CountMixture, count_mixture
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import point_estimate
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from scripts.benchmarks.machine import peak_memory_GB

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
N_WALKERS = 32


def sampling(options: argparse.Namespace) -> dict[str, Any]:
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    plan = load_plan(CONFIGS / "plans" / "paper_grid.yaml", rig)
    truth = json.loads((CONFIGS / "truth" / "paper_simulation.json").read_text())
    readings = simulate(rig, plan, truth, options.seed).calibration
    set_up_s: dict[str, list[float]] = {}

    model = MeasurementModel.build(rig, readings)
    continuous = LogPosterior(Coordinates(rig), model, readings)
    fit, set_up_s["point estimate"] = timed(lambda: fitted(continuous, readings, truth, options), options)
    with torch.no_grad():
        model = model.choose_rules(continuous.coordinates.values(fit.vector[0]))
    continuous = LogPosterior(continuous.coordinates, model, readings)
    lattice = LogPosterior(Coordinates(rig, integer_counts=True), model, readings)
    on_lattice, set_up_s["Laplace mixture over loop counts"] = timed(
        lambda: mixture_of(continuous, lattice, fit, options.seed), options
    )
    on_reals = mixture_of(continuous, continuous, fit, options.seed)

    def coilcal(posterior: LogPosterior, mixture: CountMixture, max_steps: int) -> dict[str, Any]:
        def run(seed: int) -> tuple[int, Convergence]:
            settings = SamplerSettings(N_WALKERS, target_ess=options.ess, max_steps=max_steps, seed=seed)
            samples = sample(posterior, mixture, settings)
            return samples.n_steps * N_WALKERS, samples.convergence

        return repeated(run, options)

    rows = {"coilcal, whole counts": coilcal(lattice, on_lattice, 20_000)}
    result = {
        "title": f"{len(readings)} readings, {lattice.coordinates.n} parameters, {N_WALKERS} walkers; set-up:",
        "set_up_s": set_up_s,
        "peak_memory_GB": peak_memory_GB(),
        "rows": rows,
    }
    rows["coilcal, real counts"] = coilcal(continuous, on_reals, options.stretch_steps)
    rows["emcee stretch move, real counts"] = repeated(
        lambda seed: stretch(continuous, fit, options.stretch_steps, seed), options
    )
    if options.numpyro:
        from scripts.benchmarks.nuts import Nuts

        nuts = Nuts(rig, readings, continuous, fit.vector[0], model.rules["coil1"])
        rows["NumPyro NUTS, real counts, jax"] = repeated(nuts.run, options)
        set_up_s["compilation of NUTS"] = [nuts.compilation_s] * 3
    return result


def fitted(
    posterior: LogPosterior, readings: Observations, truth: dict[str, float], options: argparse.Namespace
) -> Optimum:
    if options.tiny:
        return levenberg_marquardt(posterior, posterior.coordinates.vector(truth)[None])
    return point_estimate(posterior, readings, options.seed).fit


def mixture_of(continuous: LogPosterior, target: LogPosterior, fit: Optimum, seed: int) -> CountMixture:
    mixture = count_mixture(continuous, target, fit, np.random.default_rng(seed))
    if mixture is None:
        raise RuntimeError("the loop counts of this session are too uncertain for a table")
    return mixture


def stretch(posterior: LogPosterior, fit: Optimum, steps: int, seed: int) -> tuple[int, Convergence]:
    """Plain emcee with its default move on the same kernel, started in the posterior."""

    def log_prob(vectors: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return posterior(torch.from_numpy(vectors)).numpy()

    random = np.random.RandomState(seed)
    start = random.multivariate_normal(fit.vector[0].numpy(), covariance(fit.precision)[0].numpy(), N_WALKERS)
    sampler = emcee.EnsembleSampler(N_WALKERS, start.shape[1], log_prob, vectorize=True)
    state = emcee.State(start, random_state=random.get_state())
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    chain = sampler.get_chain(discard=int(BURN_IN_SHARE * steps))
    return steps * N_WALKERS, convergence(reported_parameters(posterior.coordinates, chain))


def repeated(run: Callable[[int], tuple[int, Convergence]], options: argparse.Namespace) -> dict[str, Any]:
    """The row of a sampler over seeded repeats; its time includes burn-in and diagnostics."""
    seconds, ess, rhat, evaluations = [], [], [], []
    for i in range(options.repeats):
        begin = time.perf_counter()
        number, diagnostics = run(options.seed + i)
        seconds.append(time.perf_counter() - begin)
        ess.append(diagnostics.smallest_ess)
        rhat.append(diagnostics.largest_rhat)
        evaluations.append(number)
    rates = [e / s for e, s in zip(ess, seconds, strict=True)]
    return {
        "seconds": middle_and_ends(seconds),
        "ess_per_s": middle_and_ends(rates),
        "smallest_ess": float(np.median(ess)),
        "largest_rhat": float(max(rhat)),
        "evaluations": int(np.median(evaluations)),
        "is_reached": min(ess) >= options.ess and max(rhat) <= SamplerSettings().largest_rhat,
    }


def timed(function: Callable[[], Any], options: argparse.Namespace) -> tuple[Any, list[float]]:
    seconds = []
    for _ in range(options.repeats):
        begin = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - begin)
    return result, middle_and_ends(seconds)


def middle_and_ends(values: list[float]) -> list[float]:
    return [float(np.median(values)), float(min(values)), float(max(values))]

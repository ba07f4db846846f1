"""Effective samples per second of the slowest parameter on the paper's simulated coil.

By default 125 and 512 readings, without and with a free gain of each axis of the sensor. coilcal samples whole loop counts. emcee's
stretch move and NUTS cannot: they sample the same readings and priors with real-valued counts, as does coilcal a second time for
comparison. All call the same density, NUTS its own in jax. A call for few points is mostly overhead, so plain emcee runs a second time
with many walkers.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from estimator import SamplerSettings, load_plan, load_rig, simulate
from estimator.benchmarks.sampling import N_WALKERS, mixture_of, stretch
from estimator.effects.attach import with_effect
from estimator.inference.convergence import Convergence
from estimator.inference.ensemble import sample
from estimator.inference.lattice import CountMixture
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import point_estimate
from estimator.model.hide import cause_of
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from scripts.benchmarks.machine import peak_memory_GB

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
MANY_WALKERS, MANY_SHARE = 512, 0.4  # of plain emcee, and its share of the steps


def sampling(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """A table for each grid and each effect that is free."""
    paper = CONFIGS / "plans" / "paper_grid.yaml"
    with tempfile.TemporaryDirectory() as folder:
        for side in options.sides:
            plan = Path(folder) / "plan.yaml"
            plan.write_text(paper.read_text().replace("count: 5}", f"count: {side}}}"))
            for effect in options.free:
                yield case(options, plan, None if effect == "nothing" else effect)


def case(options: argparse.Namespace, plan_path: Path, effect: str | None) -> dict[str, Any]:
    """All samplers on the readings of one plan; NUTS knows no effects."""
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    truth = json.loads((CONFIGS / "truth" / "paper_simulation.json").read_text())
    readings = simulate(rig, load_plan(plan_path, rig), truth, options.seed).calibration
    if effect is not None:
        rig = with_effect(rig, cause_of(effect, rig), readings, {})
        truth = {**{name: parameter.value for name, parameter in rig.parameters.items()}, **truth}
    set_up_s: dict[str, list[float]] = {}

    model = MeasurementModel.build(rig, readings)
    continuous = LogPosterior(Coordinates(rig), model, readings)
    fit, set_up_s["point estimate"] = timed(lambda: fitted(continuous, readings, truth, options))
    with torch.no_grad():
        model = model.choose_rules(continuous.coordinates.values(fit.vector[0]))
    continuous = LogPosterior(continuous.coordinates, model, readings)
    lattice = LogPosterior(Coordinates(rig, integer_counts=True), model, readings)
    on_lattice, set_up_s["Laplace mixture over loop counts"] = timed(
        lambda: mixture_of(continuous, lattice, fit, options.seed)
    )
    on_reals = mixture_of(continuous, continuous, fit, options.seed)

    def coilcal(posterior: LogPosterior, mixture: CountMixture) -> dict[str, Any]:
        def run(seed: int) -> tuple[int, Convergence]:
            settings = SamplerSettings(N_WALKERS, target_ess=options.ess, seed=seed)
            samples = sample(posterior, mixture, settings)
            return samples.n_steps * N_WALKERS, samples.convergence

        return repeated(run, options)

    rows = {
        "coilcal, whole counts": coilcal(lattice, on_lattice),
        "coilcal, real counts": coilcal(continuous, on_reals),
    }
    memory_GB = peak_memory_GB()
    for n_walkers, share in ((N_WALKERS, 1.0), (MANY_WALKERS, MANY_SHARE)):
        steps = int(share * options.stretch_steps)
        rows[f"emcee stretch move, {n_walkers} walkers, real counts"] = repeated(
            lambda seed, n=n_walkers, steps=steps: stretch(continuous, fit, steps, n, seed), options
        )
    if options.numpyro and effect is None:
        from scripts.benchmarks.nuts import Nuts

        nuts = Nuts(rig, readings, continuous, fit.vector[0], model.rules["coil1"])
        rows["NumPyro NUTS, real counts, jax"] = repeated(nuts.run, options)
        set_up_s["compilation of NUTS"] = [nuts.compilation_s] * 3
    named = f", {effect} free" if effect else ""
    return {
        "title": f"{len(readings)} readings{named}, {lattice.coordinates.n} parameters, {N_WALKERS} walkers; set-up:",
        "set_up_s": set_up_s,
        "peak_memory_GB": memory_GB,
        "rows": rows,
    }


def fitted(
    posterior: LogPosterior, readings: Observations, truth: dict[str, float], options: argparse.Namespace
) -> Optimum:
    if options.tiny:
        return levenberg_marquardt(posterior, posterior.coordinates.vector(truth)[None])
    return point_estimate(posterior, readings, options.seed).fit


def repeated(run: Callable[[int], tuple[int, Convergence]], options: argparse.Namespace) -> dict[str, Any]:
    """The row of a sampler over seeded repeats; its processor time includes burn-in and diagnostics."""
    seconds, ess, rhat, evaluations = [], [], [], []
    for i in range(options.repeats):
        begin = time.process_time()
        number, diagnostics = run(options.seed + i)
        seconds.append(time.process_time() - begin)
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


def timed(function: Callable[[], Any]) -> tuple[Any, list[float]]:
    begin = time.process_time()
    result = function()
    return result, [time.process_time() - begin] * 3


def middle_and_ends(values: list[float]) -> list[float]:
    return [float(np.median(values)), float(min(values)), float(max(values))]

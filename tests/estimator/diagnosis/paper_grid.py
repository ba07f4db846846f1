"""The paper's grid of 5 x 5 x 5 positions at 3 A and 20 uT, in several orders and at several distances; pose and winding are free."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import torch

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.next_readings.resolution import smallest_visible
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import load_rig

ROOT = Path(__file__).parents[3]
TRUTH = {
    name: float(value)
    for name, value in json.loads(
        (ROOT / "configs/truth/paper_simulation.json").read_text(encoding="utf-8")
    ).items()
}


def paper_rig(fixed: Iterable[str] = ("hall.noise_T",)) -> Rig:
    """The paper's simulated rig with a known noise, at the truth."""
    return load_rig(ROOT / "configs/paper_simulation.yaml").with_values(TRUTH).with_fixed(fixed)


def places_mm(order: str, half_mm: tuple[float, float, float] = (50.0, 50.0, 25.0)) -> np.ndarray:
    """The grid. In `raster` order every row begins at the same end, in `snake` order where the last one ended."""
    grid = [np.linspace(-half, half, 5) for half in half_mm]
    if order == "snake":
        indices = [
            (i, j if i % 2 == 0 else 4 - j, k if (5 * i + j) % 2 == 0 else 4 - k)
            for i, j, k in product(range(5), repeat=3)
        ]
    else:
        indices = list(product(range(5), repeat=3))
    if order == "random":
        indices = [indices[i] for i in np.random.default_rng(0).permutation(125)]
    return np.array([[axis[i] for axis, i in zip(grid, index, strict=True)] for index in indices])


def visit(
    rig: Rig,
    middle_mm: float,
    order: str,
    *,
    currents_A: tuple[float, ...] = (3.0,),
    repeats: int = 1,
    seed: int = 1,
) -> Observations:
    """Readings of the grid whose middle lies that far in front of the coil, the coil being displaced."""
    poses = tuple({"arm1": np.array([*(1e-3 * place), 0.0, 0.0, 0.0])} for place in places_mm(order))
    settings = tuple({"coil1": current_A} for current_A in currents_A)
    plan = Plan("grid", poses, (), settings, "raster", repeats, 1.0)
    return simulate(rig, plan, at(rig, middle_mm), seed)


def at(rig: Rig, middle_mm: float) -> dict[str, float]:
    """The truth with the coil that far behind the middle of its displacements."""
    truth = {name: value for name, value in TRUTH.items() if name in rig.parameters}
    return {**truth, "coil1.world_from_coil0.z_m": -1e-3 * middle_mm}


@dataclass(frozen=True)
class Resolved:
    """A fit, and the candidates whose visibility is asked."""

    fit: Fit
    pool: list[Candidate]

    def sizes(self, name: str) -> dict[str, float]:
        """Smallest visible size of each quantity of a cause."""
        return {v.key: v.size for v in smallest_visible(self.fit, self.pool) if v.cause.name == name}


def resolved(rig: Rig, observations: Observations, names: Iterable[str], middle_mm: float) -> Resolved:
    """Fit the rig and take the columns of some causes."""
    truth = at(rig, middle_mm)
    true_rig = rig.with_values(truth)
    rules = MeasurementModel.build(true_rig, observations).rules
    fit = fit_rig(true_rig, observations, truth, rules)
    wanted = set(names)
    return Resolved(
        fit, candidates(fit, [cause for cause in causes_of(true_rig, fit) if cause.name in wanted])
    )


def columns_of(result: Resolved, cause: Cause, key: str) -> torch.Tensor:
    """Whitened column of one quantity."""
    candidate = next(c for c in result.pool if c.cause == cause)
    return candidate.columns[:, candidate.keys.index(key)]

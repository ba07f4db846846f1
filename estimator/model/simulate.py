"""Simulated sessions: perfect readings of a known truth and of causes that are hidden in it, then noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from estimator.effects.noise import Outliers, PositionJitter
from estimator.effects.record import UnitError
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput
from estimator.model.hide import with_hidden
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, observations_of
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

MOST_DRAWS = 100
TOLERANCE = 1e-10


def draw_truth(rig: Rig, seed: int) -> dict[str, float]:
    """Values of the free parameters drawn from their priors; loop counts as whole numbers, windings that leave a bore.

    Raises:
        InvalidInput: The priors allow next to no possible rig.
    Examples:
        >>> from estimator.rig_files.read import load_rig
        >>> truth = draw_truth(load_rig("configs/paper_simulation.yaml"), seed=1)
        >>> truth["coil1.axial_loops"] == round(truth["coil1.axial_loops"])
        True
    """
    coordinates = Coordinates(rig, integer_counts=True)
    rng = np.random.default_rng(seed)
    for _ in range(MOST_DRAWS):
        values = coordinates.values(coordinates.sample_prior(rng, 1)[0])
        truth = {name: float(values[name]) for name in coordinates.names}
        if rig.with_values(truth).broken_rule() is None:
            return truth
    raise InvalidInput(
        f"priors of rig {rig.name!r} must allow windings that leave a bore; {MOST_DRAWS} draws have none"
    )


def simulate(
    rig: Rig, plan: Plan, truth: Mapping[str, float], seed: int, hidden: Mapping[str, float] | None = None
) -> Observations:
    """Readings that the plan would give if the truth were so, with the noise of the truth.

    Args:
        rig: Names and fixed values.
        plan: Poses and currents.
        truth: Values that replace the rig's nominal ones; `<sensor>.noise_T` is the noise added, 0 allowed.
        seed: Of order and noise.
        hidden: Causes that the rig knows nothing of, such as `{"axis_gain[hall].x": 0.01}` (see `with_hidden`).
    Raises:
        InvalidInput: The truth names what the rig has not, is no possible rig, or puts a sensor inside a winding.
    """
    real = rig.with_values(truth)
    broken = real.broken_rule()
    if broken is not None:
        name, rule, value = broken
        raise InvalidInput(f"truth: {name} {rule}; received {value} (rig {rig.name!r})")
    rng = np.random.default_rng(seed)
    observations = observations_of(plan, rig, rng)
    real = with_hidden(real, observations, hidden or {})
    nominal = _tensors(real)
    model = MeasurementModel.build(real, observations, tolerance=TOLERANCE)
    field_T = model.predict(nominal)
    noise = torch.from_numpy(rng.normal(size=tuple(field_T.shape)))
    noise_T = torch.stack([nominal[f"{sensor.name}.noise_T"] for sensor in rig.sensors])[
        observations.sensor, None
    ]
    return observations.with_field(
        field_T + noise * noise_T * _wildness(real, observations, rng) + _jitter(model, rng)
    )


def perfect_readings(rig: Rig, observations: Observations) -> torch.Tensor:
    """What perfect sensors would read at the rig's nominal values; summed to 1e-10, far below any noise."""
    return MeasurementModel.build(rig, observations, tolerance=TOLERANCE).predict(_tensors(rig))


def _tensors(rig: Rig) -> dict[str, torch.Tensor]:
    return {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}


def _wildness(rig: Rig, observations: Observations, rng: np.random.Generator) -> torch.Tensor:
    """Factor on the noise of each component: more for outliers, and what a wrong unit makes of it."""
    factor = torch.ones(len(observations), 3, dtype=torch.float64)
    values = _tensors(rig)
    for use in uses_of(rig, Outliers):
        theta = use.theta(values)
        is_wild = torch.from_numpy(rng.random(size=tuple(factor.shape))) < theta["share"]
        is_wild &= (observations.sensor == use.index(rig.sensors))[:, None]
        factor = torch.where(is_wild, theta["ratio"], factor)
    for unit in uses_of(rig, UnitError):
        factor = factor * unit.theta(values)["field_factor"]
    return factor


def _jitter(model: MeasurementModel, rng: np.random.Generator) -> torch.Tensor:
    """What a mover that scatters about its targets adds, to first order."""
    added_T = torch.zeros(len(model.circumstances), 3, dtype=torch.float64)
    for use in uses_of(model.rig, PositionJitter):
        off_m = (
            torch.from_numpy(rng.normal(size=(len(model.circumstances), 3)))
            * use.theta(_tensors(model.rig))["sd_m"]
        )
        added_T = added_T + torch.einsum("rij,rj->ri", model.gradient_T_per_m(use.place), off_m)
    return added_T

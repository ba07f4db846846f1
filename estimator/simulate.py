"""Simulated sessions: perfect readings of a known truth, then noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from estimator.chain import Chain
from estimator.coordinates import Coordinates
from estimator.errors import InvalidInput
from estimator.plan import Plan, observations_of
from estimator.records import Observations
from estimator.rig import Rig

MOST_DRAWS = 100


def draw_truth(rig: Rig, seed: int) -> dict[str, float]:
    """Values of the free parameters drawn from their priors; loop counts as whole numbers, windings that leave a bore.

    Raises:
        InvalidInput: The priors allow next to no possible rig.
    Examples:
        >>> from estimator.config import load_rig
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


def simulate(rig: Rig, plan: Plan, truth: Mapping[str, float], seed: int) -> Observations:
    """Readings that the plan would give if the truth were so, with the noise of the truth.

    Args:
        rig: Names and fixed values.
        plan: Poses and currents.
        truth: Values that replace the rig's nominal ones; `<sensor>.noise_T` is the noise added, 0 allowed.
        seed: Of order and noise.
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
    field_T = perfect_readings(real, observations)
    values = real.nominal_values()
    noise_T = np.array([values[f"{sensor.name}.noise_T"] for sensor in rig.sensors])
    noise = rng.normal(size=tuple(field_T.shape)) * noise_T[observations.sensor.numpy(), None]
    return observations.with_field(field_T + torch.from_numpy(noise))


def perfect_readings(rig: Rig, observations: Observations) -> torch.Tensor:
    """What perfect sensors would read at the rig's nominal values; summed to 1e-10, far below any noise."""
    nominal = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    return Chain.build(rig, observations, tolerance=1e-10).predict(nominal)

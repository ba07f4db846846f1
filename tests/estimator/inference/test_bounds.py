"""Newton steps inside the bounds of the prior, beside another optimizer's."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import torch

from estimator.inference.bounds import AT_A_BOUND, Inside
from estimator.inference.positive_definite import solve
from estimator.rig.coordinates import Coordinates
from estimator.rig_files.read import rig_from_text

# One number in a logarithm, and numbers at neither, one or both of their bounds.
RIG = """
schema_version: 1
name: test
coils: {c: {radius_mm: 40, wire_radius_mm: 1, axial_loops: 1, radial_loops: 1, current_gain: {prior: {uniform: {lower: 0.9, upper: 1.1}}},
  world_from_coil: {x_mm: {prior: {normal: {mean: 0, sd: 2, lower: -1, upper: 1}}}, y_mm: {prior: {normal: {mean: 0, sd: 2, lower: -1}}},
  z_mm: {prior: {normal: {mean: 0, sd: 2}}}}}}
sensors: {hall: {noise_uT: {prior: {log_normal: {median: 5, relative_sd: 1}}}}}
"""


@pytest.fixture(scope="module")
def coordinates() -> Coordinates:
    return Coordinates(rig_from_text(RIG))


@pytest.mark.parametrize("seed", range(8))
def test_step_is_that_of_a_solver_for_the_coordinates_at_bounds(coordinates, seed):
    """The solver bounds only the coordinates that lie at a bound, for others the step may leave."""
    rng = np.random.default_rng(seed)
    lower, upper = (ends.numpy() for ends in coordinates.bounds())
    at_low, at_high = rng.random(coordinates.n) < 0.4, rng.random(coordinates.n) < 0.4
    by_name = dict(coordinates.rig.nominal_values())
    held = {}
    for i, name in enumerate(coordinates.names):
        for is_at, end, side in ((at_low[i], lower[i], (0.0, None)), (at_high[i], upper[i], (None, 0.0))):
            if is_at and np.isfinite(end) and name not in held and name != "hall.noise_T":
                by_name[name], held[name] = float(end), side
    scale = coordinates.scale.numpy()
    root = rng.normal(size=(coordinates.n, coordinates.n)) / scale
    precision, gradient = (
        root.T @ root + np.diag(1.0 / scale**2),
        rng.normal(size=coordinates.n) * 5.0 / scale,
    )
    inside = Inside(coordinates, coordinates.vector(by_name))
    step = inside.step_of_the_free(torch.tensor(precision), torch.tensor(gradient))

    def loss(z: np.ndarray) -> float:
        return float(0.5 * (z * scale) @ precision @ (z * scale) - gradient @ (z * scale))

    def slope(z: np.ndarray) -> np.ndarray:
        return np.asarray((precision @ (z * scale) - gradient) * scale)

    sides = [held.get(name, (None, None)) for name in coordinates.names]
    best = scipy.optimize.minimize(
        loss, np.zeros(coordinates.n), jac=slope, bounds=sides, options={"ftol": 1e-15, "gtol": 1e-10}
    )
    assert float(loss(step.numpy() / scale)) == pytest.approx(best.fun, abs=1e-6 * abs(best.fun))


def test_inside_it_is_newtons_step(coordinates):
    precision = torch.diag(coordinates.scale**-2)
    gradient = 3.0 / coordinates.scale
    step = Inside(coordinates, coordinates.start()).step_of_the_free(precision, gradient)
    assert torch.equal(step, solve(precision, gradient))


def test_next_to_a_bound_it_is_free(coordinates):
    column = coordinates.names.index("c.world_from_coil.x_m")
    vector, precision = coordinates.start(), torch.diag(coordinates.scale**-2)
    gradient = 3.0 / coordinates.scale
    steps = []
    for share in (0.5, 2.0):
        vector[column] = 1e-3 - share * AT_A_BOUND * 2e-3
        steps.append(float(Inside(coordinates, vector).step_of_the_free(precision, gradient)[column]))
    assert steps[0] == pytest.approx(0.0, abs=1e-12)
    assert steps[1] > 1e-3

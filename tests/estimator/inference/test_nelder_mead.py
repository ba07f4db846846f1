"""Nelder-Mead: SciPy's trajectory, invariants at every step, and starts that do not disturb each other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

from estimator.inference.nelder_mead import (
    Coefficients,
    NelderMeadResult,
    SimplexState,
    evaluated,
    initial_simplex,
    minimise,
    step,
)

pytestmark = pytest.mark.whole


# These functions use operators only, so that SciPy evaluates them on NumPy arrays with the same arithmetic.
def rosenbrock(x):
    return (100 * (x[..., 1:] - x[..., :-1] ** 2) ** 2 + (1 - x[..., :-1]) ** 2).sum(-1)


def ellipsoid(x):
    """Minimum 0 at (1, 1, ...), curvatures between 1 and 10."""
    n = x.shape[-1]
    return sum((1 + 9 * i / n) * (x[..., i] - 1) ** 2 for i in range(n))


def kinked(x):
    """A valley with a kink along its floor."""
    return (x[..., 0] ** 2 + 1e-3) ** 0.5 + abs(x[..., 1:] - x[..., :-1]).sum(-1) + (x**4).sum(-1)


def rugged(x):
    """A bowl with a sawtooth: many local minima, many shrinks."""
    return (x**2 + abs(x % 0.3 - 0.15)).sum(-1)


def random_simplexes(n_starts: int, n_parameters: int) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.randn(n_starts, n_parameters + 1, n_parameters, generator=generator, dtype=torch.float64)


def simplex_at(*start: float, scale: float) -> Tensor:
    origin = torch.tensor([start], dtype=torch.float64)
    return initial_simplex(origin, torch.full_like(origin[0], scale))


def tightly(objective: Callable[[Tensor], Tensor], vertices: Tensor, **options) -> NelderMeadResult:
    defaults = {"x_tolerance": 1e-7, "f_tolerance": 1e-12, "max_iterations": 2000}
    return minimise(objective, vertices, **(defaults | options))


class Recorder:
    """An objective that remembers the rows of every call."""

    def __init__(self, objective: Callable[[Tensor], Tensor]):
        self.objective, self.calls = objective, []

    def __call__(self, x: Tensor) -> Tensor:
        self.calls.append(x.clone())
        return self.objective(x)

    @property
    def n_rows(self) -> int:
        return sum(len(call) for call in self.calls)


def scipy_after(n_steps: int, function: Callable, simplex: np.ndarray) -> tuple:
    options = {
        "initial_simplex": simplex,
        "adaptive": True,
        "maxiter": n_steps + 1,  # SciPy counts from 1
        "maxfev": math.inf,
        "xatol": 0.0,
        "fatol": 0.0,
    }
    result = scipy.optimize.minimize(function, simplex[0], method="Nelder-Mead", options=options)
    return *result.final_simplex, result.nfev


@pytest.mark.parametrize("n_parameters", [2, 4, 10])
@pytest.mark.parametrize("function", [rosenbrock, ellipsoid, kinked, rugged])
def test_each_of_sixty_steps_gives_the_simplex_of_scipy(function, n_parameters):
    vertices = random_simplexes(2, n_parameters)
    states: list[SimplexState] = []
    options = {"max_iterations": 60, "on_step": states.append}
    minimise(function, vertices, x_tolerance=0.0, f_tolerance=0.0, **options)
    for n_steps, state in enumerate(states, start=1):
        x, f, n_evaluations = scipy_after(n_steps, function, vertices[1].numpy())
        assert np.allclose(state.vertices[1], x, rtol=1e-12, atol=1e-12 * np.abs(x).max())
        assert np.allclose(state.values[1], f, rtol=1e-12, atol=0)
        assert state.n_evaluations[1] == n_evaluations
    assert len(states) == 60


REFLECTED, EXPANDED, OUTSIDE, INSIDE = (2.0, -2.0), (3.0, -4.0), (1.5, -1.0), (0.5, 1.0)
SHRUNKEN = {(1.0, 0.0): 5.0, (0.0, 1.0): 6.0}


@pytest.mark.parametrize(
    ("trial_values", "accepted"),
    [
        ({REFLECTED: -1.0, EXPANDED: -2.0}, [EXPANDED]),
        ({REFLECTED: -1.0, EXPANDED: -1.0}, [REFLECTED]),
        ({REFLECTED: 0.0}, [REFLECTED]),
        ({REFLECTED: 0.9}, [REFLECTED]),
        ({REFLECTED: 1.0, OUTSIDE: 1.0}, [OUTSIDE]),
        ({REFLECTED: 1.0, OUTSIDE: 1.1} | SHRUNKEN, list(SHRUNKEN)),
        ({REFLECTED: 2.0, INSIDE: 1.9}, [INSIDE]),
        ({REFLECTED: 2.0, INSIDE: 2.0} | SHRUNKEN, list(SHRUNKEN)),
    ],
)
def test_each_rule_decides_ties_as_scipy_does(trial_values, accepted):
    values = {(0.0, 0.0): 0.0, (2.0, 0.0): 1.0, (0.0, 2.0): 2.0} | trial_values
    objective = Recorder(lambda x: torch.tensor([values[tuple(row)] for row in x.tolist()], dtype=x.dtype))
    state = evaluated(objective, torch.tensor([[[0, 0], [2, 0], [0, 2]]], dtype=torch.float64))
    after = step(state, objective, Coefficients.for_dimension(2))
    new = set(map(tuple, after.vertices[0].tolist())) - set(map(tuple, state.vertices[0].tolist()))
    assert new == set(accepted)
    assert after.n_evaluations.item() == objective.n_rows == 3 + len(trial_values)


@pytest.mark.parametrize("function", [rosenbrock, kinked, rugged])
def test_invariants_hold_at_every_step_of_every_start_and_restart(function):
    best = [torch.full((8,), math.inf, dtype=torch.float64)]

    def check(state: SimplexState) -> None:
        assert (state.values.diff(dim=1) >= 0).all(), "values are sorted"
        assert (state.values[:, 0] <= best[-1]).all(), "the best value never rises"
        torch.testing.assert_close(state.values, function(state.vertices), rtol=1e-13, atol=0)
        best.append(state.values[:, 0])

    result = tightly(function, random_simplexes(8, 4), x_tolerance=1e-5, n_restarts=1, on_step=check)
    assert len(best) > 100
    assert torch.equal(result.values, best[-1])


def test_batched_equals_looped():
    starts = random_simplexes(1, 3)[0].mul(64).round() / 64  # simplexes of one size, to the last digit
    vertices = initial_simplex(starts, torch.full((3,), 0.5, dtype=torch.float64))
    together = tightly(rosenbrock, vertices, n_restarts=2)
    alone = [tightly(rosenbrock, vertices[i : i + 1], n_restarts=2) for i in range(4)]
    for field in fields(NelderMeadResult):
        looped = torch.cat([getattr(result, field.name) for result in alone])
        assert torch.equal(getattr(together, field.name), looped), field.name


def mckinnon(x: Tensor) -> Tensor:
    """Minimum -0.25 at (0, -0.5); the search can stagnate at (0, 0), where the slope is 1.

    K. I. M. McKinnon, SIAM J. Optim. 9 (1998) 148-158, with tau = 2, theta = 6, phi = 60.
    """
    return torch.where(x[:, 0] <= 0, 360.0, 6.0) * x[:, 0] ** 2 + x[:, 1] + x[:, 1] ** 2


def mckinnon_simplex() -> Tensor:
    root = math.sqrt(33)
    return torch.tensor([[[0, 0], [1, 1], [(1 + root) / 8, (1 - root) / 8]]], dtype=torch.float64)


def test_restarts_rescue_the_stagnating_simplex_of_mckinnon():
    stuck = tightly(mckinnon, mckinnon_simplex())
    assert stuck.is_converged.all()
    assert stuck.values.abs() < 1e-9
    rescued = tightly(mckinnon, mckinnon_simplex(), n_restarts=5)
    assert rescued.is_converged.all()
    torch.testing.assert_close(rescued.points, torch.tensor([[0, -0.5]]).double(), rtol=0, atol=1e-6)


def test_a_start_out_of_iterations_is_reported_and_not_restarted():
    result = tightly(rosenbrock, random_simplexes(3, 3), max_iterations=4, n_restarts=5)
    assert not result.is_converged.any()


def test_convergence_holds_the_values_to_their_tolerance():
    states: list[SimplexState] = []
    vertices = simplex_at(0.0, 0.0, scale=1.0)
    result = tightly(ellipsoid, vertices, x_tolerance=10.0, f_tolerance=1e-3, on_step=states.append)
    spreads = [float(state.values[0, -1] - state.values[0, 0]) for state in states]
    assert result.is_converged.all()
    assert [spread <= 1e-3 for spread in spreads] == [False] * (len(states) - 1) + [True]


def test_convergence_holds_every_parameter_to_its_own_tolerance():
    unit = torch.tensor([1.0, 1e-6], dtype=torch.float64)
    tolerance = 1e-3 * unit
    states: list[SimplexState] = []
    vertices = initial_simplex(torch.zeros(1, 2).double(), unit)
    options = {"x_tolerance": tolerance, "f_tolerance": 1.0, "max_iterations": 500, "on_step": states.append}
    result = minimise(lambda x: ellipsoid(x / unit), vertices, **options)
    extents = [(state.vertices - state.vertices[:, :1]).abs().amax(dim=(0, 1)) for state in states]
    assert result.is_converged.all()
    assert [bool((extent <= tolerance).all()) for extent in extents] == [False] * (len(states) - 1) + [True]


@pytest.mark.parametrize("forbidden", [math.inf, math.nan])
def test_forbidden_regions_are_left_and_avoided(forbidden):
    def bowl_beside_a_cliff(x: Tensor) -> Tensor:
        return torch.where(x[:, 0] > 0.9, ellipsoid(x), forbidden)

    objective, best = Recorder(bowl_beside_a_cliff), []
    vertices = simplex_at(0.0, 3.0, 3.0, scale=1.5)  # only one of its vertices is allowed
    result = tightly(objective, vertices, on_step=lambda state: best.append(state.vertices[0, 0]))
    assert sum(int((rows[:, 0] <= 0.9).sum()) for rows in objective.calls) > 3, "the cliff was met again"
    assert all(point[0] > 0.9 for point in best)
    assert result.is_converged.all()
    torch.testing.assert_close(result.points, torch.ones(1, 3).double(), rtol=0, atol=1e-6)


DEVICES = [
    "cpu",
    pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")),
]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_and_device_are_kept_and_no_gradient_is_recorded(dtype, device):
    centre = torch.ones(2, dtype=dtype, device=device, requires_grad=True)
    vertices = simplex_at(0.0, 0.0, scale=0.5).to(device, dtype)
    options = {"x_tolerance": 1e-3, "f_tolerance": 1e-3, "max_iterations": 200, "n_restarts": 1}
    result = minimise(lambda x: (x - centre).square().sum(dim=-1), vertices, **options)
    for tensor in (result.points, result.values):
        assert (tensor.dtype, tensor.device, tensor.requires_grad) == (dtype, vertices.device, False)
    torch.testing.assert_close(result.points[0], centre.detach(), rtol=0, atol=0.1)

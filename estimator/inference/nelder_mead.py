"""Nelder-Mead for many starts at once: one call of the objective evaluates them all.

This is the first step of inference. It needs no derivative and tolerates regions where the model is undefined
(+inf), so it finds the basin that `levenberg_marquardt` refines. Each start follows SciPy's trajectory, step by step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

Objective = Callable[[Float[Tensor, "start parameter"]], Float[Tensor, " start"]]


@dataclass(frozen=True)
class Coefficients:
    """Lengths of the moves relative to the reflection; `shrink` is the factor on every edge."""

    expansion: float
    contraction: float
    shrink: float

    @staticmethod
    def for_dimension(n_parameters: int) -> Coefficients:
        """Moves that grow gentler with the dimension, which keeps the simplex from collapsing; up to 2 the classic values.

        References: Gao and Han, Comput. Optim. Appl. 51 (2012) 259-277, eq 4.1.
        Examples:
            >>> Coefficients.for_dimension(10)
            Coefficients(expansion=1.2, contraction=0.7, shrink=0.9)
        """
        n = max(n_parameters, 2)  # at 1 the rule would shrink the simplex to a point
        return Coefficients(expansion=1 + 2 / n, contraction=0.75 - 1 / (2 * n), shrink=1 - 1 / n)


@dataclass(frozen=True)
class SimplexState:
    """All simplexes at one moment; the vertices of each are sorted, best first."""

    vertices: Float[Tensor, "start vertex parameter"]
    values: Float[Tensor, "start vertex"]
    is_active: Bool[Tensor, " start"]
    n_evaluations: Int[Tensor, " start"]


@dataclass(frozen=True)
class NelderMeadResult:
    """The best point of every start; `is_converged` is false where the last simplex ran out of iterations."""

    points: Float[Tensor, "start parameter"]
    values: Float[Tensor, " start"]
    is_converged: Bool[Tensor, " start"]
    n_evaluations: Int[Tensor, " start"]


def initial_simplex(
    start: Float[Tensor, "start parameter"], scale: Float[Tensor, " parameter"]
) -> Float[Tensor, "start vertex parameter"]:
    """Simplexes with each start and its neighbours one step along every axis.

    MATLAB's fminsearch moves a parameter that starts at 0 by only 0.00025; this is why the rotations in the
    paper hardly moved. Here the step does not depend on the value.

    Args:
        start: Starting points.
        scale: Signed step of each parameter, such as its prior width.
    Returns: The vertices; the first one is the start itself.
    References: Osinde et al., Table 8 (rotations started at exactly 0).
    Examples:
        >>> initial_simplex(torch.zeros(1, 2), torch.tensor([0.5, 2.0]))
        tensor([[[0.0000, 0.0000],
                 [0.5000, 0.0000],
                 [0.0000, 2.0000]]])
    """
    origin = start.unsqueeze(1)
    return torch.cat([origin, origin + torch.diag(scale)], dim=1)


def evaluated(objective: Objective, vertices: Float[Tensor, "start vertex parameter"]) -> SimplexState:
    """The initial state: every vertex evaluated, every start active; of each start a vertex must have a value below +inf."""
    values = _evaluate(objective, vertices)
    starts = torch.arange(len(vertices), device=vertices.device)
    zeros = torch.zeros_like(starts)
    state = SimplexState(vertices, values, is_active=zeros == 0, n_evaluations=zeros)
    return _replaced(state, starts, vertices, values, n_evaluated=zeros + vertices.shape[1])


def step(state: SimplexState, objective: Objective, coefficients: Coefficients) -> SimplexState:
    """One iteration of every active start, in at most three calls of the objective.

    The calls evaluate all reflections; the expansions and contractions of those that need one; the shrunken
    simplexes. Starts that are not active are neither evaluated nor changed.

    Args:
        state: Simplexes from `evaluated` or the step before.
        objective: See `minimise`.
        coefficients: Lengths of the moves.
    Returns: The simplexes after the iteration, sorted.
    References: Lagarias et al., SIAM J. Optim. 9 (1998) 112-147, section 2.
    """
    active = state.is_active.nonzero().squeeze(-1)
    x, f = state.vertices[active], state.values[active]  # copies, so that `state` stays as it is
    n_parameters = x.shape[-1]
    f_best, f_second_worst, f_worst = f[:, 0], f[:, -2], f[:, -1]
    x_worst, centroid = x[:, -1], x[:, :-1].sum(dim=1) / n_parameters

    x_reflected = 2 * centroid - x_worst
    f_reflected = _evaluate(objective, x_reflected)

    expands = f_reflected < f_best
    contracts = f_reflected >= f_second_worst
    contracts_outside = contracts & (f_reflected < f_worst)
    reach = torch.full_like(f_worst, -coefficients.contraction)  # inside, unless one of the other two
    reach[expands] = coefficients.expansion
    reach[contracts_outside] = coefficients.contraction
    x_second = (1 + reach).unsqueeze(-1) * centroid - reach.unsqueeze(-1) * x_worst
    needs_second = expands | contracts
    f_second = torch.full_like(f_worst, math.inf)
    f_second[needs_second] = _evaluate(objective, x_second[needs_second])

    f_to_beat = torch.where(expands, f_reflected, f_worst)
    takes_second = torch.where(contracts_outside, f_second <= f_reflected, f_second < f_to_beat)
    shrinks = contracts & ~takes_second
    moves = ~shrinks
    x[moves, -1] = torch.where(takes_second.unsqueeze(-1), x_second, x_reflected)[moves]
    f[moves, -1] = torch.where(takes_second, f_second, f_reflected)[moves]
    x[shrinks, 1:] = x[shrinks, :1] + coefficients.shrink * (x[shrinks, 1:] - x[shrinks, :1])
    f[shrinks, 1:] = _evaluate(objective, x[shrinks, 1:])

    n_evaluated = 1 + needs_second.long() + n_parameters * shrinks.long()
    return _replaced(state, active, x, f, n_evaluated)


@torch.no_grad()  # otherwise an objective with gradients would link all iterations in one graph
def minimise(
    objective: Objective,
    vertices: Float[Tensor, "start vertex parameter"],
    *,
    x_tolerance: float | Float[Tensor, " parameter"],
    f_tolerance: float,
    max_iterations: int,
    n_restarts: int = 0,
    on_step: Callable[[SimplexState], None] | None = None,
) -> NelderMeadResult:
    """Minimise the objective from every starting simplex.

    A start has converged when no vertex is farther from the best one than `x_tolerance`, and none is worse by
    more than `f_tolerance`. A simplex that collapsed far from a minimum satisfies this too. A fresh simplex around
    the best point, as large as the largest first one, therefore tries again, as long as that improves the value by more than `f_tolerance`.

    Args:
        objective: Function to minimise, over rows; +inf forbids a point, and NaN counts as +inf.
        vertices: Starting simplexes, such as those of `initial_simplex`.
        x_tolerance: Absolute, in the unit of each parameter.
        f_tolerance: Absolute, in the unit of the objective.
        max_iterations: Largest number of iterations of a simplex; every restart has as many again.
        n_restarts: Largest number of restarts of a start.
        on_step: Called with the state after every iteration.
    Returns: The best point of every start.
    Examples:
        >>> result = minimise(
        ...     lambda x: (x - 3).square().sum(dim=-1),
        ...     initial_simplex(torch.zeros(1, 2).double(), torch.ones(2).double()),
        ...     x_tolerance=1e-6, f_tolerance=1e-12, max_iterations=500,
        ... )
        >>> result.points.round(decimals=4)
        tensor([[3., 3.]], dtype=torch.float64)
    """
    coefficients = Coefficients.for_dimension(vertices.shape[-1])
    extent = (vertices - vertices[:, :1]).abs().amax(dim=(0, 1))

    def is_converged(state: SimplexState) -> Tensor:
        x, f = state.vertices, state.values
        is_small = ((x[:, 1:] - x[:, :1]).abs() <= x_tolerance).all(dim=-1).all(dim=-1)
        return is_small & (f[:, -1] - f[:, 0] <= f_tolerance)

    def run(state: SimplexState) -> SimplexState:
        for _ in range(max_iterations):
            state = replace(state, is_active=state.is_active & ~is_converged(state))
            if not state.is_active.any():
                break
            state = step(state, objective, coefficients)
            if on_step is not None:
                on_step(state)
        return state

    state = run(evaluated(objective, vertices))
    previous_best = torch.full_like(state.values[:, 0], math.inf)
    for _ in range(n_restarts):
        best = state.values[:, 0]
        restarts = is_converged(state) & (previous_best - best > f_tolerance)
        if not restarts.any():
            break
        state = run(_restarted(state, restarts, objective, extent))
        previous_best = best

    points, values = state.vertices[:, 0], state.values[:, 0]
    return NelderMeadResult(points, values, is_converged(state), state.n_evaluations)


def _restarted(state: SimplexState, restarts: Tensor, objective: Objective, extent: Tensor) -> SimplexState:
    """Fresh simplexes around the best points, whose values are known; only those starts are active."""
    index = restarts.nonzero().squeeze(-1)
    x, f = initial_simplex(state.vertices[index, 0], extent), state.values[index]
    f[:, 1:] = _evaluate(objective, x[:, 1:])
    state = replace(state, is_active=restarts)
    return _replaced(state, index, x, f, n_evaluated=torch.full_like(index, len(extent)))


def _replaced(state: SimplexState, at: Tensor, x: Tensor, f: Tensor, n_evaluated: Tensor) -> SimplexState:
    """The state with the simplexes of the starts `at` replaced; they are sorted here."""
    order = f.argsort(dim=1, stable=True)
    return replace(
        state,
        vertices=state.vertices.index_copy(0, at, x.take_along_dim(order.unsqueeze(-1), dim=1)),
        values=state.values.index_copy(0, at, f.take_along_dim(order, dim=1)),
        n_evaluations=state.n_evaluations.index_add(0, at, n_evaluated),
    )


def _evaluate(objective: Objective, points: Tensor) -> Tensor:
    """Values of points with any leading axes; NaN, which is neither better nor worse, becomes +inf."""
    rows = points.flatten(0, -2)
    if len(rows) == 0:
        return points.new_empty(points.shape[:-1])
    values = objective(rows)
    return torch.where(values.isnan(), math.inf, values).reshape(points.shape[:-1])

"""Steps of a climb inside the bounds of the prior: along them where they hold a coordinate back.

A maximum on a bound has a gradient that pushes beyond it. What a step can still gain, and so whether the climb has ended, is that of the
coordinates which nothing holds.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.positive_definite import solve, solve_each
from estimator.rig.coordinates import Coordinates

APPROACH = 0.9  # of the way to a bound in one step
MOST_CORRECTIONS = 5
AT_A_BOUND = 1e-6  # standard deviations of the prior from a bound, within which it holds a coordinate


def step_of_the_free(
    coordinates: Coordinates,
    vector: Float[Tensor, " coordinate"],
    precision: Float[Tensor, "continuous continuous"],
    gradient: Float[Tensor, " continuous"],
) -> Float[Tensor, " continuous"]:
    """Newton step that leaves values alone which lie at a bound and which it would push beyond.

    Args:
        coordinates: Whose priors have the bounds.
        vector: A point inside them.
        precision, gradient: Of the log density there.
    References: Nocedal and Wright, Numerical Optimization, 2nd ed., section 16.5 (active sets).
    """
    step = solve(precision, gradient)
    with torch.no_grad():
        by_name = coordinates.values(vector)
    values = torch.stack([by_name[name] for name in coordinates.names])
    lower, upper = coordinates.bounds()
    near = AT_A_BOUND * values.new_tensor([p.prior.sd for p in coordinates.parameters if p.prior])
    is_low, is_high = values - lower < near, upper - values < near
    if not (is_low | is_high).any():
        return step
    slopes, is_held = coordinates.slopes_of_values(vector), torch.zeros_like(is_low)
    free = step
    while True:
        moves = slopes @ free
        pushes = ((is_low & (moves < 0.0)) | (is_high & (moves > 0.0))) & ~is_held
        if not pushes.any():
            return free
        is_held |= pushes
        constraints = slopes[is_held]
        directions = solve_each(precision, constraints.mT)
        free = step - directions @ torch.linalg.lstsq(constraints @ directions, constraints @ step).solution


def along_bounds(coordinates: Coordinates, vector: Tensor, damped: Tensor, step: Tensor) -> Tensor:
    """The best damped step inside the prior: it approaches the bounds that it would overstep, and slides along them.

    References: Nocedal and Wright, Numerical Optimization, 2nd ed., section 16.1 (equality-constrained quadratic programs).
    """
    n = coordinates.n_continuous

    def free_values(continuous: Tensor) -> Tensor:
        values = coordinates.values(torch.cat((continuous, vector[n:])))
        return torch.stack([values[name] for name in coordinates.names])

    lower, upper = coordinates.bounds()
    values, jacobian = free_values(vector[:n]), coordinates.slopes_of_values(vector)
    is_held, target = torch.zeros_like(values, dtype=torch.bool), values.clone()
    bounded_step = step
    # Bounds are curved in these coordinates: solve to first order, then correct with the exact values.
    first_order = (lambda move: values + jacobian @ move, coordinates.n)
    exact = (lambda move: free_values(vector[:n] + move), MOST_CORRECTIONS)
    for values_after, rounds in (first_order, exact):
        for _ in range(rounds):
            new_values = values_after(bounded_step)
            is_outside = (new_values < lower) | (new_values > upper)
            if not is_outside.any():
                break
            ahead = values + APPROACH * (torch.where(new_values < lower, lower, upper) - values)
            target = torch.where(is_outside & ~is_held, ahead, target)
            is_held |= is_outside
            constraints = jacobian[is_held]
            directions = solve_each(damped, constraints.mT)
            violation = (new_values - target)[is_held]
            system = constraints @ directions
            if not (torch.isfinite(system).all() and torch.isfinite(violation).all()):
                return step  # no first-order model of the bounds so far out: the step is refused and the damping grows
            multipliers = torch.linalg.lstsq(system, violation[:, None]).solution[:, 0]
            bounded_step = bounded_step - directions @ multipliers
    return bounded_step

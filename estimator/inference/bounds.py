"""Steps of a climb inside the bounds of the prior: along them where they hold a coordinate back.

A maximum on a bound has a gradient that pushes beyond it. What a step can still gain, and so whether the climb has ended, is that of the
coordinates which nothing holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.positive_definite import solve, solve_each
from estimator.least_squares import least_squares
from estimator.rig.coordinates import Coordinates

APPROACH = 0.9  # of the way to a bound in one step
MOST_CORRECTIONS = 5
AT_A_BOUND = 1e-6  # standard deviations of the prior from a bound, within which it holds a coordinate


@dataclass(frozen=True)
class Inside:
    """A point inside the bounds of the prior, from which steps are taken.

    Attributes:
        coordinates: Whose priors have the bounds.
        vector: The point.
    """

    coordinates: Coordinates
    vector: Float[Tensor, " coordinate"]

    @cached_property
    def _values(self) -> Float[Tensor, " coordinate"]:
        """Values of the free parameters there."""
        with torch.no_grad():
            return self._free_values(self.vector)

    def _free_values(self, vector: Float[Tensor, " coordinate"]) -> Float[Tensor, " coordinate"]:
        values = self.coordinates.values(vector)
        return torch.stack([values[name] for name in self.coordinates.names])

    @cached_property
    def _slopes(self) -> Float[Tensor, "coordinate continuous"]:
        """Derivatives of these values in the continuous coordinates."""
        return self.coordinates.slopes_of_values(self.vector)

    def step_of_the_free(
        self, precision: Float[Tensor, "continuous continuous"], gradient: Float[Tensor, " continuous"]
    ) -> Float[Tensor, " continuous"]:
        """Newton step that leaves values alone which lie at a bound and which it would push beyond.

        Args:
            precision, gradient: Of the log density at the point.
        References: Nocedal and Wright, Numerical Optimization, 2nd ed., section 16.5 (active sets).
        """
        step = solve(precision, gradient)
        lower, upper = self.coordinates.bounds()
        sd = lower.new_tensor([p.prior.sd for p in self.coordinates.parameters if p.prior])
        is_low, is_high = (
            distance < AT_A_BOUND * sd for distance in (self._values - lower, upper - self._values)
        )
        if not (is_low | is_high).any():
            return step
        free, is_held = step, torch.zeros_like(is_low)
        of_each = solve_each(precision, self._slopes.mT)
        while True:
            moves = self._slopes @ free
            pushes = ((is_low & (moves < 0.0)) | (is_high & (moves > 0.0))) & ~is_held
            if not pushes.any():
                return free
            is_held |= pushes
            constraints, directions = self._slopes[is_held], of_each[:, is_held]
            free = step - directions @ least_squares(constraints @ directions, constraints @ step)

    def along_bounds(
        self, damped: Float[Tensor, "continuous continuous"], step: Float[Tensor, " continuous"]
    ) -> Float[Tensor, " continuous"]:
        """The best damped step inside the prior: it approaches the bounds that it would overstep, and slides along them.

        Args:
            damped: Precision with damping.
            step: The damped step without bounds.
        References: Nocedal and Wright, Numerical Optimization, 2nd ed., section 16.1 (equality-constrained quadratic programs).
        """
        coordinates, values, n = self.coordinates, self._values, self.coordinates.n_continuous

        def after(move: Tensor) -> Tensor:
            return self._free_values(torch.cat((self.vector[:n] + move, self.vector[n:])))

        lower, upper = coordinates.bounds()
        is_held, target = torch.zeros_like(values, dtype=torch.bool), values.clone()
        bounded_step, of_each = step, solve_each(damped, self._slopes.mT)
        # Bounds are curved in these coordinates: solve to first order, then correct with the exact values.
        first_order = (lambda move: values + self._slopes @ move, coordinates.n)
        exact = (after, MOST_CORRECTIONS)
        for values_after, rounds in (first_order, exact):
            for _ in range(rounds):
                new_values = values_after(bounded_step)
                is_outside = (new_values < lower) | (new_values > upper)
                if not is_outside.any():
                    break
                ahead = values + APPROACH * (torch.where(new_values < lower, lower, upper) - values)
                target = torch.where(is_outside & ~is_held, ahead, target)
                is_held |= is_outside
                constraints, directions = self._slopes[is_held], of_each[:, is_held]
                violation = (new_values - target)[is_held]
                system = constraints @ directions
                if not (torch.isfinite(system).all() and torch.isfinite(violation).all()):
                    return step  # no first-order model of the bounds so far out: the step is refused and the damping grows
                multipliers = least_squares(system, violation)
                bounded_step = bounded_step - directions @ multipliers
        return bounded_step

"""The prior density of all free parameters of a rig, in the coordinates that a fit moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from estimator.rig.natural import ExternalRadius, Logarithm, Natural, natural_of
from estimator.rig.parameters import LogNormal, Normal, Parameter, Uniform, normal_log_density
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch


class JointPrior:
    """The prior density of free parameters, including the Jacobian determinant of their coordinates.

    There may be hundreds of parameters, so priors of one form are evaluated together: normal and uniform ones of parameters that are
    coordinates themselves, and log-normal ones of parameters whose logarithms are.

    Args:
        rig: Whose parameters they are.
        parameters: The free parameters.
        natural: What the coordinate of each is.
    """

    def __init__(self, rig: Rig, parameters: Sequence[Parameter], natural: Sequence[Natural]) -> None:
        plain: dict[str, tuple[float, float, float, float]] = {}
        of_logarithm: dict[str, tuple[float, float, float, float]] = {}
        self._others: list[tuple[Parameter, Natural]] = []
        self.joint = rig.joint and rig.joint.among([parameter.name for parameter in parameters])
        for parameter, own in zip(parameters, natural, strict=True):
            prior, name = parameter.prior, parameter.name
            is_plain = not isinstance(own, ExternalRadius | Logarithm)
            if prior is not None and self.joint and name in self.joint.names:
                plain[name] = (0.0, math.inf, prior.lower, prior.upper)
            elif isinstance(prior, Normal) and is_plain:
                plain[name] = (prior.mean, prior.standard_deviation, prior.lower, prior.upper)
            elif isinstance(prior, Uniform) and is_plain:
                plain[name] = (0.0, math.inf, prior.lower, prior.upper)
            elif isinstance(prior, LogNormal) and isinstance(own, Logarithm):
                lower = math.log(prior.lower) if prior.lower > 0.0 else -math.inf
                of_logarithm[name] = (math.log(prior.median), prior.relative_sd, lower, math.log(prior.upper))
            else:
                self._others.append((parameter, own))
        self._together = [
            (list(of), torch.tensor(list(of.values()), dtype=torch.float64).T, is_log)
            for of, is_log in ((plain, False), (of_logarithm, True))
            if of
        ]
        if self.joint:
            self._natural = natural_of(rig, [rig.parameters[name] for name in self.joint.names], ())
            nominal = rig.with_values(
                {p.name: p.prior.centre for p in parameters if p.prior}
            ).nominal_values()
            self._mean = self._columns(
                {name: torch.tensor(x, dtype=torch.float64) for name, x in nominal.items()}
            )
            self._root = torch.linalg.cholesky(torch.tensor(self.joint.covariance, dtype=torch.float64))
            self._whitening = torch.linalg.inv(self._root).T

    def _columns(self, values: Mapping[str, Tensor]) -> Float[Tensor, "*batch joint"]:
        """Coordinates of the parameters that have a prior together, loop counts by their logarithms."""
        columns = [own.coordinate(values[own.name], values.__getitem__) for own in self._natural]
        return torch.stack(torch.broadcast_tensors(*columns), dim=-1)

    def log_density(
        self, values: Mapping[str, Tensor], vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch"]:
        """Log density up to a constant.

        Args:
            values: Every number of the rig at the vector.
            vector: The coordinates.
        """
        total = torch.zeros(vector.shape[:-1], dtype=vector.dtype, device=vector.device)
        for names, numbers, is_log in self._together:
            together = torch.stack(torch.broadcast_tensors(*(values[name] for name in names)), dim=-1)
            together = torch.log(together) if is_log else together
            total = total + normal_log_density(together, *numbers.to(vector)).sum(-1)
        for parameter, own in self._others:
            value = values[parameter.name]
            assert parameter.prior is not None
            total = total + parameter.prior.log_density(value) + own.log_slope(value, values.__getitem__)
        if self.joint:
            distance = self._columns(values) - self._mean.to(vector)
            total = total - 0.5 * (distance @ self._whitening.to(vector)).square().sum(-1)
        return total

    def sample_joint(self, rng: np.random.Generator, size: int) -> Float[Tensor, "size joint"]:
        """Draws of the coordinates of the parameters that have a prior together."""
        normal = torch.from_numpy(rng.normal(size=(size, len(self._mean))))
        return self._mean + normal @ self._root.T

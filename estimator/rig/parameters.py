"""Parameters of a rig and the priors they may carry.

A parameter is fixed (a value), free (a value and a prior) or tied to another parameter by a factor. Its name is its dotted path in
the rig file with the SI unit as suffix, `coil1.wire_radius_m`; loop counts and gains are pure numbers.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimator.errors import InvalidInput
from estimator.tensors import Tensor, torch


class Prior(ABC):
    """Prior probability density of a parameter, in the parameter's unit."""

    lower: float
    upper: float

    @property
    @abstractmethod
    def centre(self) -> float:
        """A typical value, from which a fit may start."""

    @property
    @abstractmethod
    def sd(self) -> float:
        """Width of the prior: its standard deviation, before truncation."""

    @property
    @abstractmethod
    def log_normaliser(self) -> float:
        """Constant that `log_density` leaves out; with it the density integrates to 1 (truncation aside)."""

    @abstractmethod
    def log_density(self, value: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Log density up to a constant; -inf outside the support."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Draws from the prior."""

    def distance(self, value: float) -> float:
        """Distance of a value from the centre, in prior standard deviations."""
        return (value - self.centre) / self.sd

    def _inside(self, value: Tensor, log_density: Tensor) -> Tensor:
        outside = (value < self.lower) | (value > self.upper)
        return torch.where(outside, torch.full_like(log_density, -math.inf), log_density)


@dataclass(frozen=True)
class Normal(Prior):
    """Normal prior, truncated where bounds are given.

    Examples:
        >>> Normal(48.0, 2.0).log_density(torch.tensor(50.0))
        tensor(-0.5000)
    """

    mean: float
    standard_deviation: float
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        _require(self.standard_deviation > 0.0, "normal.sd must be > 0", self.standard_deviation)
        _require(self.lower < self.upper, "normal.lower must be below upper", (self.lower, self.upper))

    @property
    def centre(self) -> float:
        return min(max(self.mean, self.lower), self.upper)

    @property
    def sd(self) -> float:
        return self.standard_deviation

    @property
    def log_normaliser(self) -> float:
        from scipy.special import ndtr  # a quarter of a second, which no command needs that only reads a rig

        ends = [(bound - self.mean) / self.standard_deviation for bound in (self.lower, self.upper)]
        probability = float(ndtr(ends[1]) - ndtr(ends[0]))
        return -math.log(self.standard_deviation) - 0.5 * math.log(2.0 * math.pi) - math.log(probability)

    def log_density(self, value: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        return normal_log_density(value, self.mean, self.standard_deviation, self.lower, self.upper)

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        from scipy import stats  # takes a second to load, which only draws from a prior need

        low, high = ((bound - self.mean) / self.sd for bound in (self.lower, self.upper))
        draws = stats.truncnorm.rvs(low, high, loc=self.mean, scale=self.sd, size=size, random_state=rng)
        return np.asarray(draws)


def normal_log_density(
    value: Float[Tensor, "*batch"],
    mean: float | Float[Tensor, "*#batch"],
    standard_deviation: float | Float[Tensor, "*#batch"],
    lower: float | Float[Tensor, "*#batch"],
    upper: float | Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch"]:
    """Log density of truncated normal priors up to a constant; -inf outside their bounds."""
    is_outside = (value < lower) | (value > upper)
    return torch.where(is_outside, -math.inf, -0.5 * ((value - mean) / standard_deviation) ** 2)


@dataclass(frozen=True)
class LogNormal(Prior):
    """Log-normal prior of a positive quantity, truncated where bounds are given."""

    median: float
    relative_sd: float
    lower: float = 0.0
    upper: float = math.inf

    def __post_init__(self) -> None:
        _require(self.median > 0.0, "log_normal.median must be > 0", self.median)
        _require(self.relative_sd > 0.0, "log_normal.relative_sd must be > 0", self.relative_sd)
        _require(self.lower >= 0.0, "log_normal.lower must be at least 0", self.lower)
        _require(self.lower < self.upper, "log_normal.lower must be below upper", (self.lower, self.upper))

    @property
    def centre(self) -> float:
        return min(max(self.median, self.lower), self.upper)

    @property
    def sd(self) -> float:
        return self.median * self.relative_sd

    @property
    def log_normaliser(self) -> float:
        return -math.log(self.relative_sd) - 0.5 * math.log(2.0 * math.pi)

    def log_density(self, value: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        log_value = torch.log(value.clamp(min=1e-300))
        density = -0.5 * ((log_value - math.log(self.median)) / self.relative_sd) ** 2 - log_value
        return self._inside(value, density)

    def distance(self, value: float) -> float:
        return math.log(value / self.median) / self.relative_sd

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        bounds = [math.log(bound) if bound > 0.0 else -math.inf for bound in (self.lower, self.upper)]
        normal = Normal(math.log(self.median), self.relative_sd, *bounds)
        return np.asarray(np.exp(normal.sample(rng, size)))


@dataclass(frozen=True)
class Uniform(Prior):
    """Uniform prior between two bounds."""

    lower: float
    upper: float

    def __post_init__(self) -> None:
        _require(self.lower < self.upper, "uniform.lower must be below upper", (self.lower, self.upper))

    @property
    def centre(self) -> float:
        return 0.5 * (self.lower + self.upper)

    @property
    def sd(self) -> float:
        return (self.upper - self.lower) / math.sqrt(12.0)

    @property
    def log_normaliser(self) -> float:
        return -math.log(self.upper - self.lower)

    def log_density(self, value: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        return self._inside(value, torch.zeros_like(value))

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        return rng.uniform(self.lower, self.upper, size)


@dataclass(frozen=True)
class JointNormal:
    """A normal law of some parameters together, in place of the widths of their own priors, whose centres and bounds stay.

    It is a law of their coordinates (`estimator.rig.natural`), in which posteriors are close to normal.

    Attributes:
        names: Of the parameters.
        covariance: Its rows; each coordinate is a logarithm, or in the parameter's unit.
    """

    names: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]

    def among(self, names: Collection[str]) -> JointNormal | None:
        """What it says of those of its parameters that are among some others; None where none are.

        Examples:
            >>> JointNormal(("a", "b"), ((2.0, 1.0), (1.0, 3.0))).among(["b", "c"])
            JointNormal(names=('b',), covariance=((3.0,),))
        """
        index = [i for i, name in enumerate(self.names) if name in names]
        rows = tuple(tuple(self.covariance[i][j] for j in index) for i in index)
        return JointNormal(tuple(self.names[i] for i in index), rows) if index else None


@dataclass(frozen=True)
class Tie:
    """A parameter that follows another: value = factor x the other's value."""

    to: str
    factor: float = 1.0


@dataclass(frozen=True)
class Parameter:
    """One number of the rig.

    Attributes:
        name: Dotted path with SI unit, unique in the rig.
        unit: SI unit; "1" for pure numbers.
        value: Nominal value, from which a fit starts. Ignored if the parameter is tied.
        prior: Prior of a free parameter; None otherwise.
        tie: Tie of a parameter that follows another; None otherwise.
        is_positive: The parameter is positive and fitted as a logarithm.
        is_count: The true value is a whole number (loop counts).
    """

    name: str
    unit: str
    value: float
    prior: Prior | None = None
    tie: Tie | None = None
    is_positive: bool = False
    is_count: bool = False

    @property
    def is_free(self) -> bool:
        """Whether a fit may move this parameter."""
        return self.prior is not None


def _require(holds: bool, rule: str, value: object) -> None:
    if not holds:
        raise InvalidInput(f"{rule}; received {value}")

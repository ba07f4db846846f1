"""A sequential test of whether a calibration still holds: the likelihood ratio of each possible change, with Wald's bounds.

Where the calibration holds, the readings are normal about its predictions, with the covariance of its parameters and the noise. A change is
a multiple of a known column of either sign, of a stated size, or an unknown scatter of that size. Were none there, the mean of the
likelihood ratios of all changes is a martingale, whatever decides where to measure next and when to end. It exceeds 1/a at any time with
probability a at most: that is the rate of false alarms. Were one there, the inverse of its ratio is such a martingale: it falls below b at
any time with probability b at most, which is the rate of misses.

References: Wald, Annals of Mathematical Statistics 16, 117 (1945); Ville, Étude critique de la notion de collectif (1939).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from jaxtyping import Float

from estimator.tensors import Tensor, torch

FALSE_ALARMS = 0.01  # share of sessions that call a calibration changed which holds
MISSES = 0.05  # share of sessions that call a calibration valid beside a change of the stated size


@dataclass(frozen=True)
class Innovations:
    """Readings as independent standard normal numbers where the calibration holds; later readings do not change earlier numbers.

    Attributes:
        residual: Measured less predicted, whitened.
        columns: What each change of unit size adds to it.
        scatter: Unknown scatter of the stated size over the noise, of each component; zero where it is not asked for.
    """

    residual: Float[Tensor, " component"]
    columns: Float[Tensor, "component change"]
    scatter: Float[Tensor, " component"]

    @classmethod
    def of(
        cls,
        residual: Float[Tensor, " component"],
        own: Float[Tensor, "component parameter"],
        covariance: Float[Tensor, "parameter parameter"],
        changes: Float[Tensor, "component change"],
        scatter: Float[Tensor, " component"],
    ) -> Innovations:
        """Whiten readings in their order.

        Args:
            residual: Measured less predicted, over the noise.
            own: Derivatives in the parameters of the calibration, over the noise.
            covariance: Of these parameters.
            changes: What each change of unit size adds, over the noise.
            scatter: Unknown scatter of the stated size over the noise.
        """
        spread = own @ covariance @ own.T + torch.eye(len(own), dtype=own.dtype)
        root = torch.linalg.cholesky(spread)
        both = torch.cat((residual[:, None], changes), dim=1)
        whitened = torch.linalg.solve_triangular(root, both, upper=False)
        return cls(whitened[:, 0], whitened[:, 1:], scatter / root.diagonal())

    def log_ratios(self, sizes: Float[Tensor, " change"]) -> Float[Tensor, " hypothesis"]:
        """Logarithm of the likelihood ratio of each change of a size and either sign against none.

        The last one is unknown scatter, where it is asked for.

        Args:
            sizes: Of the changes.

        Examples:
            >>> one = torch.ones(1, dtype=torch.float64)
            >>> readings = Innovations(2.0 * one, one[:, None], 0.0 * one)
            >>> [round(float(x), 3) for x in readings.log_ratios(one)]
            [0.825]
        """
        score = sizes * (self.columns.T @ self.residual)
        certainty = sizes.square() * self.columns.square().sum(0)
        either_sign = score.abs() + torch.log1p(torch.exp(-2.0 * score.abs())) - math.log(2.0)
        ratios = either_sign - 0.5 * certainty
        if not bool(self.scatter.any()):
            return ratios
        more = 1.0 + self.scatter.square()
        unknown = 0.5 * (self.residual.square() * (1.0 - 1.0 / more) - torch.log(more)).sum()
        return torch.cat((ratios, unknown[None]))

    def log_likelihoods(self) -> Float[Tensor, " change"]:
        """Logarithm of the likelihood of each change at its most probable size, over that of none."""
        return 0.5 * self.fitted_sizes().square() * self.columns.square().sum(0)

    def fitted_sizes(self) -> Float[Tensor, " change"]:
        """Most probable size of each change, were it there alone."""
        square = self.columns.square().sum(0).clamp(min=1e-300)
        return (self.columns.T @ self.residual) / square


@dataclass(frozen=True)
class Rates:
    """Error rates of a test.

    Attributes:
        false_alarms: Probability of calling a calibration changed which holds, at most.
        misses: Probability of calling it valid beside any one change of the stated size, at most.
    """

    false_alarms: float = FALSE_ALARMS
    misses: float = MISSES

    def holds(self, log_ratios: Float[Tensor, " hypothesis"]) -> bool:
        """Whether every change is excluded."""
        return bool((log_ratios <= math.log(self.misses)).all())

    def has_changed(self, log_ratios: Float[Tensor, " hypothesis"]) -> bool:
        """Whether some change is there."""
        mean = torch.logsumexp(log_ratios, 0) - math.log(len(log_ratios))
        return bool(mean >= -math.log(self.false_alarms))

"""Evidence that something is wrong which shows otherwise than in the residual."""

from __future__ import annotations

import math
from dataclasses import dataclass

from estimator.diagnosis import policy


@dataclass(frozen=True)
class Doubt:
    """Evidence against a fit.

    Attributes:
        log_bayes_factor: Of something wrong, against nothing.
    """

    log_bayes_factor: float

    @property
    def probability(self) -> float:
        """Posterior probability of something wrong."""
        log_odds = self.log_bayes_factor + policy.LOG_PRIOR_ODDS_LEFT
        return 1.0 / (1.0 + math.exp(-min(max(log_odds, -700.0), 700.0)))

    @property
    def is_probable(self) -> bool:
        """Whether something wrong is as probable as what is stated."""
        return self.probability > policy.STATED

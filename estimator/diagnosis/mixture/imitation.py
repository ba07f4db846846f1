"""How probable it is that what looks like a listed cause is something that no list holds.

Something unlisted takes the name of the cause that it resembles most, and readings cannot always tell the two apart. How often it does was
counted in sessions of known truth (`make study NAME=imitations`, docs/results.md): the more often the less evidence a name has and the more
names stand beside it, and most often where a cause has an instant of its own, for whatever comes in bursts looks like a step or a spell.
Whether something unlisted is seen by itself tells nothing where there may be two such things.
"""

from __future__ import annotations

import math
from typing import NamedTuple

MOST_COUNTED = 2  # other names: sessions with more were not counted, and a large rig may have ten things wrong that are all there
LEAST_LOG_BAYES_FACTOR = 1.0  # below it a name is as doubtful as at it
WEIGHTS = (-0.6, -0.95, -1.7, 0.95)  # of the `features` of a name, in its log odds


class Standing(NamedTuple):
    """How clear a set of listed causes is, and beside what.

    Attributes:
        log_bayes_factor: Of the set against nothing, beside all else.
        n_others: Number of other listed causes that lead.
        has_instant: Whether the cause begins or ends at an instant of its own.
    """

    log_bayes_factor: float
    n_others: int = 0
    has_instant: bool = False

    @property
    def p_imitation(self) -> float:
        """Probability that, if something acts there, it is something else that no list holds.

        Examples:
            >>> Standing(300.0).p_imitation < Standing(30.0).p_imitation < 0.1
            True
            >>> Standing(30.0).p_imitation < Standing(30.0, n_others=1).p_imitation < 0.2
            True
            >>> Standing(30.0, n_others=2).p_imitation == Standing(30.0, n_others=9).p_imitation
            True
            >>> Standing(30.0, has_instant=True).p_imitation > 0.2
            True
        """
        log_odds = sum(weight * number for weight, number in zip(WEIGHTS, self.features, strict=True))
        return 1.0 / (1.0 + math.exp(log_odds))

    @property
    def features(self) -> tuple[float, float, float, float]:
        """What the log odds of a name are linear in: a constant, other names, an instant, and the logarithm of its evidence."""
        evidence = math.log(max(self.log_bayes_factor, LEAST_LOG_BAYES_FACTOR))
        return 1.0, float(min(self.n_others, MOST_COUNTED)), float(self.has_instant), evidence

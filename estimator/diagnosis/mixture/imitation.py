"""How probable it is that what looks like a listed cause is something that no list holds.

Something unlisted takes the name of the cause that it resembles most, and readings cannot always tell the two apart. How often it does was
counted in sessions of known truth (`make study NAME=imitations`, docs/results.md): beside other things that are clear, the more often the
less evidence a name has. Whether something unlisted is seen by itself tells nothing where there may be two such things.
"""

from __future__ import annotations

import math
from typing import NamedTuple

LEAST_LOG_BAYES_FACTOR = 1.0  # below it a name is as doubtful as at it
CLEAR = 15.0  # log Bayes factor from which something else counts
WEIGHTS = (-0.2, -1.2, 0.7)  # of the `features` of a name, in its log odds


class Standing(NamedTuple):
    """How clear a set of listed causes is, and beside what.

    Attributes:
        log_bayes_factor: Of the set against nothing, beside all else.
        of_others: Of everything else together.
    """

    log_bayes_factor: float
    of_others: float

    @property
    def p_imitation(self) -> float:
        """Probability that, if something acts there, it is something else that no list holds.

        Examples:
            >>> Standing(30.0, 0.0).p_imitation < 0.2 < Standing(30.0, 200.0).p_imitation
            True
            >>> Standing(30.0, 200.0).p_imitation > Standing(300.0, 200.0).p_imitation
            True
        """
        log_odds = sum(weight * number for weight, number in zip(WEIGHTS, self.features, strict=True))
        return 1.0 / (1.0 + math.exp(log_odds))

    @property
    def features(self) -> tuple[float, float, float]:
        """What the log odds of a name are linear in: whether it is alone, whether it is not, and the logarithm of its evidence."""
        is_beside = float(self.of_others > CLEAR)
        evidence = math.log(max(self.log_bayes_factor, LEAST_LOG_BAYES_FACTOR))
        return 1.0 - is_beside, is_beside, evidence

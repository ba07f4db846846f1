"""How probable it is that what looks like a listed cause is something that no list holds.

Something unlisted takes the name of the cause that it resembles most, and readings cannot always tell the two apart. How often it does was
counted in sessions of known truth (`make study NAME=imitations`, docs/results.md): the more often the less evidence a name has, the more
names stand beside it, the less sure halves of the readings could be of it, and the more what is left looks like the cause being stronger
here and weaker there. With these known, an instant of its own tells nothing more.
"""

from __future__ import annotations

import math
from typing import NamedTuple

MOST_COUNTED = 2  # other names: sessions with more were not counted, and a large rig may have ten things wrong that are all there
MOST_RELATIVE = 8.0  # log Bayes factor of a relative beyond which a name does not get worse
LEAST_EXPECTED = 3e-3  # keeps log odds finite
LEAST_LOG_BAYES_FACTOR = 1.0  # below it a name is as doubtful as at it
WEIGHTS = (1.7, -1.75, -0.75, 0.5, 0.55)  # of the `features` of a name, in its log odds


class Standing(NamedTuple):
    """How clear a set of listed causes is, and beside what.

    Attributes:
        log_bayes_factor: Of the set against nothing, beside all else.
        expected: Probability that halves of the readings are expected to give it, were it there as all readings have it.
        relative: Log Bayes factor of its change being stronger here and weaker there (`relatives.py`).
        n_others: Number of other listed causes that lead.
    """

    log_bayes_factor: float
    expected: float
    relative: float = 0.0
    n_others: int = 0

    @property
    def p_imitation(self) -> float:
        """Probability that, if something acts there, it is something else that no list holds.

        Examples:
            >>> Standing(300.0, 1.0).p_imitation < Standing(30.0, 0.9).p_imitation < 0.1
            True
            >>> Standing(30.0, 0.9).p_imitation < Standing(30.0, 0.9, n_others=1).p_imitation < 0.2
            True
            >>> Standing(30.0, 0.9, n_others=2).p_imitation == Standing(30.0, 0.9, n_others=9).p_imitation
            True
            >>> Standing(30.0, 0.9, relative=8.0).p_imitation > 0.5
            True
        """
        log_odds = sum(weight * number for weight, number in zip(WEIGHTS, self.features, strict=True))
        return 1.0 / (1.0 + math.exp(log_odds))

    @property
    def features(self) -> tuple[float, ...]:
        """What the log odds of a name are linear in: a constant, other names, its relative, log odds expected in halves, log evidence."""
        expected = math.log((self.expected + LEAST_EXPECTED) / (1.0 - self.expected + LEAST_EXPECTED))
        relative = min(max(self.relative, 0.0), MOST_RELATIVE)
        evidence = math.log(max(self.log_bayes_factor, LEAST_LOG_BAYES_FACTOR))
        return 1.0, float(min(self.n_others, MOST_COUNTED)), relative, expected, evidence

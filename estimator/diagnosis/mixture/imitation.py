"""How probable it is that what looks like a listed cause is something that no list holds.

Something unlisted takes the name of the cause that it resembles most, and readings cannot always tell the two apart. How often it does was
counted in sessions of known truth (`make study NAME=imitations`, docs/results.md): the more often the more names stand beside it, the less
sure halves of the readings could be of a name, and the more what is left looks like the cause being stronger here and weaker there. With
these known, neither the evidence of a name tells more, nor whether the cause has an instant of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

MOST_COUNTED = 2  # other names: sessions with more were not counted, and a large rig may have ten things wrong that are all there
MOST_RELATIVE = 8.0  # log Bayes factor of a relative beyond which a name does not get worse
LEAST_EXPECTED = 3e-3  # keeps log odds finite
WEIGHTS = (3.4, -1.6, -0.75, 0.65)  # of the `features` of a name, in its log odds


class Standing(NamedTuple):
    """How clear a set of listed causes is, and beside what.

    Attributes:
        expected: Probability that halves of the readings are expected to give it, were it there as all readings have it.
        relative: Log Bayes factor of its change being stronger here and weaker there (`relatives.py`).
        n_others: Number of other listed causes that lead.
    """

    expected: float
    relative: float = 0.0
    n_others: int = 0

    @property
    def p_imitation(self) -> float:
        """Probability that, if something acts there, it is something else that no list holds.

        Examples:
            >>> Standing(1.0).p_imitation < Standing(0.5).p_imitation < 0.2
            True
            >>> Standing(0.5).p_imitation < Standing(0.5, n_others=1).p_imitation < 0.5
            True
            >>> Standing(0.5, n_others=2).p_imitation == Standing(0.5, n_others=9).p_imitation
            True
            >>> Standing(0.5, relative=5.0).p_imitation > 0.2
            True
        """
        log_odds = sum(weight * number for weight, number in zip(WEIGHTS, self.features, strict=True))
        return 1.0 / (1.0 + math.exp(log_odds))

    @property
    def features(self) -> tuple[float, float, float, float]:
        """What the log odds of a name are linear in: a constant, other names, its relative, and the log odds expected in halves."""
        expected = math.log((self.expected + LEAST_EXPECTED) / (1.0 - self.expected + LEAST_EXPECTED))
        relative = min(max(self.relative, 0.0), MOST_RELATIVE)
        return 1.0, float(min(self.n_others, MOST_COUNTED)), relative, expected

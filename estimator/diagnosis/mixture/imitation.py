"""How probable it is that what looks like a listed cause is something that no list holds.

Something unlisted takes the name of the cause that it resembles most, and readings cannot always tell the two apart. How often it does was
counted in sessions of known truth (`make study NAME=imitations`, docs/results.md): the more often the more names stand beside it, the less
evidence it has where another name has more, the less of it halves of the readings show, the more what is left looks like the cause being
stronger here and weaker there, and where an instant, an axis or another start was chosen for it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from estimator.diagnosis import policy

# Other names: sessions with more were not counted, and a large rig may have ten things wrong that are all there
MOST_COUNTED = 2
MOST_RELATIVE = 8.0  # log Bayes factor of a relative beyond which a name does not get worse
ENOUGH = 100.0  # log Bayes factor from which on a name is clear, however much more another one has
LEAST_CLEAR = 0.01  # of that of the other name, or of `ENOUGH`: with less a name does not get worse
AT_OWN_LINK = 0.95  # share of departures of 95 % and more at whose link something acts: 41 of 44 in mixed sessions (585000, 576000)
AT_ITS_LINK = 0.7  # share of imitations that act at the link of what they resemble, in the same sessions


class Standing(NamedTuple):
    """How clear a set of listed causes is, and beside what.

    Attributes:
        log_bayes_factor: Of the set against nothing, beside all else.
        strongest: Largest log Bayes factor of another listed cause that leads; 0 where none leads.
        relative: Log Bayes factor of its change being stronger here and weaker there (`relatives.py`).
        n_others: Number of other listed causes that lead.
        is_chosen: Whether it has a start that no fit moves, such as an instant.
        shortage: By how much halves of the readings give it less probability than expected.
    """

    log_bayes_factor: float
    strongest: float = 0.0
    relative: float = 0.0
    n_others: int = 0
    is_chosen: bool = False
    shortage: float = 0.0

    @property
    def p_imitation(self) -> float:
        """Probability that, if something acts there, it is something else that no list holds.

        Examples:
            >>> Standing(10.0).p_imitation == Standing(10.0, 5.0).p_imitation < 0.03
            True
            >>> Standing(10.0).p_imitation < Standing(10.0, 20.0).p_imitation < Standing(10.0, 40.0).p_imitation
            True
            >>> Standing(150.0).p_imitation == Standing(150.0, 300.0).p_imitation
            True
            >>> Standing(30.0, n_others=1).p_imitation < 0.05 < Standing(30.0, n_others=2).p_imitation < 0.1
            True
            >>> Standing(30.0, n_others=2).p_imitation == Standing(30.0, n_others=9).p_imitation
            True
            >>> Standing(30.0).p_imitation < 0.03 < Standing(30.0, is_chosen=True).p_imitation
            True
            >>> Standing(30.0, relative=8.0).p_imitation > 0.2 < Standing(30.0, shortage=0.8).p_imitation
            True
        """
        log_odds = sum(
            weight * number for weight, number in zip(policy.IMITATION, self.features, strict=True)
        )
        return 1.0 / (1.0 + math.exp(log_odds))

    @property
    def features(self) -> tuple[float, ...]:
        """What the log odds of a name are linear in.

        A constant, the other names, the evidence of relatives, the log of how clear it is, whether its start was chosen, and the shortage.
        """
        n_others, relative = min(self.n_others, MOST_COUNTED), min(max(self.relative, 0.0), MOST_RELATIVE)
        clear = self.log_bayes_factor / min(ENOUGH, max(self.strongest, self.log_bayes_factor, 1.0))
        log_clear = math.log(min(max(clear, LEAST_CLEAR), 1.0))
        return 1.0, float(n_others), relative, log_clear, float(self.is_chosen), self.shortage

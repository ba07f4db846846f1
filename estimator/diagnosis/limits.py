"""What a search may ask, and when it ends before the evidence does."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from threading import Event

from estimator.diagnosis import policy
from estimator.effects.base import Effect
from estimator.rig.rig import Rig


@dataclass(frozen=True)
class Limits:
    """Limits of a search. One that reaches a limit of time or causes reports the best it has.

    Attributes:
        most_causes: Things that may be wrong at once; by default `policy.MOST_CAUSES`, and one more for each further sensor and coil.
        minutes: Time that it may take; the fit at hand is finished, and the report follows.
        stopped: Set by another thread, or a signal, to end it as if the time were over.
        is_of_change: The rig describes the same bodies as they were measured before, so only causes that can begin are asked.
        begin_s: When it began, by the monotonic clock.
    """

    most_causes: int | None = None
    minutes: float = math.inf
    stopped: Event = field(default_factory=Event)
    is_of_change: bool = False
    begin_s: float = field(default_factory=time.monotonic)

    def n_slots(self, rig: Rig) -> int:
        """Things that may be wrong at once in a rig."""
        if self.most_causes is not None:
            return self.most_causes
        return policy.MOST_CAUSES + max(len(rig.sensors) - 1, 0) + max(len(rig.coils) - 1, 0)

    def allows(self, effect: Effect) -> bool:
        """Whether a cause may be asked."""
        return effect.can_begin or not self.is_of_change

    @property
    def is_over(self) -> bool:
        """Whether the search must end."""
        return self.stopped.is_set() or time.monotonic() - self.begin_s > 60.0 * self.minutes

    @property
    def words(self) -> str:
        """Why the search ended, or must end."""
        if self.stopped.is_set():
            return "it was stopped"
        return f"its time of {self.minutes:g} min was over"

"""Which stop is next: one held out, one again, one without current, or the one of greatest expected gain by second; and who asks for it.

The gain is that of causes which are to be told apart, where there are any; else that of the goals.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.acquisition.acquire import Choice
from estimator.acquisition.pace import Pace, ways_between_s
from estimator.planning.decision import HELD_OUT_WORDS, Decided, Limits, elapsed_s
from estimator.planning.design import Design
from estimator.planning.judgement import Judged
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

# Of eight stops the last one is held out, and the fourth one is visited again
EVERY, HELD_OUT, AGAIN = 8, 7, 3
OFF_EVERY, OFF = 20, 10  # of twenty stops one is without current


class Chooser:
    """Chooses among candidates.

    Args:
        rig: As it is fitted.
        settings: The candidates, one row each.
        pace: Speeds and times.
        seed: Of the stops that are held out.
    """

    def __init__(self, rig: Rig, settings: Observations, pace: Pace, seed: int) -> None:
        self.rig, self.settings, self.pace, self.seed = rig, settings, pace, seed
        self.strength = settings.current_A.abs().sum(-1)

    def next(
        self, rows: Sequence[int], judged: Judged, is_reached: bool, is_again: bool, refused: AbstractSet[int]
    ) -> tuple[int, str, float]:
        """Number of the next candidate, why, and its gain by second.

        Args:
            rows: Candidates that were visited, in order.
            judged: What their readings say.
            is_reached: The goals are, if held-out stops and those visited again agree.
            is_again: Only stops visited again are missing.
            refused: Candidates that instruments have refused; at least one is left.
        """
        n = len(rows)
        is_due = (
            n % EVERY == AGAIN and judged.misfit.n_again <= n // EVERY
        )  # the best ones are visited again anyway
        again = [row for row in rows if row not in refused]
        if again and (is_due or is_again):
            return self._longest_ago(again), "again: shows noise, drift and backlash", 0.0
        if n % EVERY == HELD_OUT or is_reached:
            return (
                self._held_out(rows, refused),
                f"{HELD_OUT_WORDS}: judges the fit, which does not see it",
                0.0,
            )
        allowed = self._allowed(refused)
        off = (allowed & ~self.settings.current_A.any(-1)).nonzero().flatten()
        if n % OFF_EVERY == OFF and len(off):
            nearest = int(off[self.next_s(rows)[off].argmin()])
            return nearest, "no current: shows fields that are not of the coils", 0.0
        if judged.split is None:
            on = f", most of it on {judged.cause.partition(' of ')[0]}" if judged.is_most else ""
            gains, reason = Design(judged.expected).gains(), f"informs: greatest expected gain by second{on}"
        else:
            gains, reason = judged.split.gains, f"splits: tells {' from '.join(judged.split.names)}"
        by_s = torch.where(allowed, gains / self.next_s(rows), -torch.inf)
        best = int(by_s.argmax())
        return best, reason, float(by_s[best])

    def next_s(self, rows: Sequence[int]) -> Float[Tensor, " stop"]:
        """Expected duration of each candidate, were it next.

        Args:
            rows: Candidates that were visited, in order.
        """
        everything = torch.arange(len(self.settings))
        here = torch.tensor(rows[-1]) if rows else everything
        ways_s = ways_between_s(self.settings, self.rig, self.pace, here, everything)
        return ways_s + self.pace.at_rest_s(self.rig)

    def _longest_ago(self, rows: Sequence[int]) -> int:
        """The stop that was visited once, and longest ago; else the one whose last visit is."""
        last = {row: place for place, row in enumerate(rows)}
        return min(last, key=lambda row: (rows.count(row), last[row]))

    def _allowed(self, refused: AbstractSet[int]) -> Bool[Tensor, " stop"]:
        """Which candidates no instrument has refused."""
        allowed = torch.ones(len(self.settings), dtype=torch.bool)
        allowed[list(refused)] = False
        return allowed

    def _held_out(self, rows: Sequence[int], refused: AbstractSet[int]) -> int:
        """A stop by chance at the largest currents that was not visited."""
        allowed = self._allowed(refused)
        strong = allowed & (self.strength >= 0.99 * self.strength.max())
        strong[list(set(rows))] = False
        free = (strong if bool(strong.any()) else allowed).nonzero().flatten()
        generator = torch.Generator().manual_seed(self.seed + len(rows))
        return int(free[torch.randint(len(free), (), generator=generator)])


class Pilot(ABC):
    """Chooses the next stop of a session among candidates.

    Attributes:
        limits: Ends of the session beside its question.
        chooser: Has the candidates, and how long each takes.
    """

    limits: Limits
    chooser: Chooser

    @property
    @abstractmethod
    def header(self) -> dict[str, Any]:
        """Question and limits of a session, from its journal."""

    @property
    @abstractmethod
    def rows(self) -> list[int]:
        """Candidates that were visited before the last decision, in order."""

    @abstractmethod
    def decide(self, entries: Sequence[Mapping[str, Any]], refused: Sequence[int] = ()) -> Decided:
        """What the stops of a journal say; the same entries always say the same.

        Args:
            entries: Of the journal.
            refused: Candidates that instruments have refused since the last stop.
        """

    def choose(self, entries: Sequence[Mapping[str, Any]], refused: Sequence[int] = ()) -> Choice | None:
        """The next stop after those of a journal, with its decision as a record; None where the session shall end.

        Args:
            entries: Of the journal.
            refused: Candidates that instruments have refused since the last stop.
        """
        decision = self.decide(entries, refused)
        row = decision.row
        if row is None:
            return None
        this_s = float(self.chooser.next_s(self.rows)[row])
        mean_s = elapsed_s(entries) / len(entries) if entries else this_s
        record = {"decision": decision.to_json()}
        repeat, later_s = self.rows.count(row), mean_s * decision.n_later
        return Choice(row, decision.is_validation, repeat, this_s, later_s, record)

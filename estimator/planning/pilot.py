"""What chooses the stops of a session while it is measured, from what is on disk alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from estimator.acquisition.acquire import Choice
from estimator.planning.choosing import Chooser
from estimator.planning.decision import Decided, Limits, elapsed_s


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

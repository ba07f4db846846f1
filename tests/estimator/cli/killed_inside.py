"""`coilcal` that kills itself by SIGKILL at an instant of a measurement, and whose sensor shows what it showed in an earlier session.

Called as `python -m tests.estimator.cli.killed_inside INSTANT NUMBER EARLIER ARGUMENT...`, with the number of a stop.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping, Sequence
from enum import StrEnum, auto
from pathlib import Path
from typing import Any
from unittest.mock import patch

from estimator.acquisition.visit import Visit
from estimator.cli import acquire_task
from estimator.cli.main import main
from estimator.planning import autopilot
from estimator.planning.judgement import Judged, judge
from estimator.planning.so_far import SoFar
from estimator.readings.observations import Observations
from estimator.store import session
from estimator.store.files import write_text
from estimator.store.journal import Journal, read_journal


class Instant(StrEnum):
    """Where in a measurement the program is."""

    NEVER = auto()
    DECIDING = auto()  # before the readings so far are judged
    DECIDED = auto()  # before anything moves
    ARRIVED = auto()  # arms and currents are there
    READ = auto()  # before anything is stored
    TORN = auto()  # half the line of a stop is written
    STORED = auto()
    ENDED = auto()  # before the reason is written
    SEALING = auto()  # before the journal becomes arrays


class Killed:
    """A program that ends at an instant.

    Args:
        instant: Of the stop `number`, or of the end.
        shown: Entries of a session whose noise is repeated.
    """

    def __init__(self, instant: Instant, number: int, shown: Sequence[Mapping[str, Any]]) -> None:
        self.instant, self.number, self.shown = instant, number, shown
        self.n_stored = 0

    def arm(self) -> None:
        """Put the instant into the program."""
        append, go_to, enter, seal = Journal.append, Visit.go_to, Journal.__enter__, session.seal

        def entered(journal: Journal) -> Journal:
            self.n_stored = len(journal.entries)
            return enter(journal)

        def judged(so_far: SoFar) -> Judged:
            self.at(Instant.DECIDING)
            return judge(so_far)

        def gone(visit: Visit, stops: Observations, row: int) -> None:
            self.at(Instant.DECIDED)
            go_to(visit, stops, row)
            self.at(Instant.ARRIVED)

        def appended(journal: Journal, entry: Mapping[str, Any]) -> None:
            self.at(Instant.READ)
            if self.is_at(Instant.TORN):
                self._tear()
            append(journal, {**entry, "field_T": self.shown[self.n_stored]["field_T"]})
            self.at(Instant.STORED)
            self.n_stored += 1

        def written(*arguments: Any) -> None:
            self.at(Instant.ENDED)
            write_text(*arguments)

        def sealed(*arguments: Any) -> Any:
            self.at(Instant.SEALING)
            return seal(*arguments)

        for owner, name, function in (
            (autopilot, "judge", judged),
            (acquire_task, "write_text", written),
            (session, "seal", sealed),
            (Journal, "append", appended),
            (Journal, "__enter__", entered),
            (Visit, "go_to", gone),
        ):
            patch.object(owner, name, function).start()

    def is_at(self, instant: Instant) -> bool:
        """Whether this is where it shall end."""
        is_end = instant in (Instant.ENDED, Instant.SEALING)
        return instant is self.instant and (is_end or self.n_stored == self.number)

    def at(self, instant: Instant) -> None:
        """End here, if it shall."""
        if self.is_at(instant):
            os.kill(os.getpid(), signal.SIGKILL)

    def _tear(self) -> None:
        """Write half of what is written next, and end."""
        pwrite = os.pwrite

        def torn(descriptor: int, data: bytes, offset: int) -> int:
            pwrite(descriptor, data[: len(data) // 2], offset)
            self.at(Instant.TORN)
            raise AssertionError

        patch.object(os, "pwrite", torn).start()


if __name__ == "__main__":
    instant, number, earlier, *arguments = sys.argv[1:]
    Killed(Instant(instant), int(number), read_journal(Path(earlier))[1]).arm()
    main(arguments, prog_name="coilcal")

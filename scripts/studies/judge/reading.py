"""Printed lines and who judges them: a line that nobody judges is counted, so that a new sentence does not pass unseen."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from scripts.studies.judge.case import Case
from scripts.studies.judge.statements import Statement

Judge = Callable[[Case, str, re.Match[str]], Iterable[Statement]]
DIGITS = re.compile(r"[-−+]?\d[\d.,]*(e[-+]?\d+)?")


@dataclass(frozen=True)
class Reader:
    """A sentence that can be judged: how to know it, and what is true of it."""

    pattern: re.Pattern[str]
    judge: Judge


class Readers:
    """Readers of one command, in the order in which they were declared; a line may have several.

    Args:
        others: Readers that it has besides.
        advice: Patterns of lines that state nothing which can be judged, each with the reason.
    """

    def __init__(self, *others: Readers, advice: Mapping[str, str] | None = None) -> None:
        self._readers = [reader for other in others for reader in other._readers]
        self._readers += [Reader(re.compile(pattern), nothing) for pattern in advice or {}]

    def __call__(self, pattern: str) -> Callable[[Judge], Judge]:
        """Declare a reader of lines that hold this pattern."""

        def declared(judge: Judge) -> Judge:
            self._readers.append(Reader(re.compile(pattern), judge))
            return judge

        return declared

    def read(self, case: Case, lines: Sequence[str]) -> tuple[list[Statement], list[str]]:
        """Statements of some lines, and the shapes of those that no reader knows."""
        statements: list[Statement] = []
        unread: list[str] = []
        for line in filter(None, map(str.strip, lines)):
            matches = [(one.judge, match) for one in self._readers if (match := one.pattern.search(line))]
            for judge, match in matches:
                statements += judge(case, line, match)
            if not matches:
                unread.append(DIGITS.sub("#", line))
        return statements, unread


def nothing(_: Case, __: str, ___: re.Match[str]) -> Iterator[Statement]:
    """For lines that state nothing of the session."""
    return iter(())

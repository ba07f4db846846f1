"""Which stop is next, or why a session ends, as its journal holds it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

HELD_OUT_WORDS = "held out"  # that the reason of such a stop begins with


@dataclass(frozen=True)
class Limits:
    """Ends of a session beside its goals.

    Attributes:
        most_stops: Number of stops.
        longest_s: Time; None for no limit.
    """

    most_stops: int
    longest_s: float | None = None


@dataclass(frozen=True)
class Decided:
    """Which stop is next, or why there is none.

    Attributes:
        row: Number of the candidate; None ends the session.
        reason: In words.
    """

    row: int | None
    reason: str

    @property
    def is_validation(self) -> bool:
        """Whether the readings shall be held out of the fit."""
        return self.reason.startswith(HELD_OUT_WORDS)

    @property
    def n_later(self) -> int:
        """Stops that are expected after this one; 0 where nothing says how many."""
        return 0

    def to_json(self) -> dict[str, Any]:
        """An entry of the journal of a session."""
        return asdict(self)


@dataclass(frozen=True)
class Decision(Decided):
    """A decision by goals.

    Attributes:
        widths: Half-width of the 90 % interval of each goal over its target, widened by what the readings contradict.
        misfit_T: Root mean square of what held-out readings show beyond noise and uncertainty.
        gain_per_s: Expected fall of the logarithm of the criterion, or expected log evidence between causes that are told apart, by
            second of travel, ramps and readings; 0 where it is not why.
        n_candidates: Number of stops to choose from.
        left: Stops that are expected to be still needed.
        cause: The ordinary cause that may do most unseen, with the size that the readings give it.
        stated: Causes that not even all stops could exclude, taken as the rig file states them.
        refused: Numbers of the candidates that instruments have refused; they are not chosen again.
    """

    widths: tuple[float, ...]
    misfit_T: float
    gain_per_s: float
    n_candidates: int
    left: int
    cause: str = ""
    stated: tuple[str, ...] = ()
    refused: tuple[int, ...] = ()

    @property
    def n_later(self) -> int:
        """Stops that are expected after this one."""
        return max(0, self.left - 1)


def refused_before(entries: Sequence[Mapping[str, Any]]) -> set[int]:
    """Candidates that instruments refused before the last stop."""
    return set(entries[-1].get("decision", {}).get("refused", ())) if entries else set()


def elapsed_s(entries: Sequence[Mapping[str, Any]]) -> float:
    """Time from the beginning of a session to its last entry."""
    return float(entries[-1].get("end_s") or entries[-1]["time_s"])

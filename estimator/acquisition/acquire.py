"""Measures a session: visits the stops of a plan in order and appends the readings of each to the journal.

`estimator.acquisition.visit` carries out each stop. The instruments arrive behind the limits of the rig (`drivers.guarded`).
The currents are ramped to zero at the end of a run, whether it succeeded or not.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

from drivers.errors import BroughtToRest, Refused
from estimator.acquisition.pace import ANSWER_S, Pace, durations_s
from estimator.acquisition.visit import Instruments, Visit
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.growing import StopReadings
from estimator.store.journal import Journal

_LOG = logging.getLogger(__name__)

MOST_REFUSED = 20  # stops one after the other; then something else is wrong than one place


@dataclass(frozen=True)
class Progress:
    """Progress of a run, reported after each stop once its readings are on disk.

    Attributes:
        n_done: Number of stops visited, including those of earlier runs.
        n_stops: Number of stops in the plan.
        left_s: Estimated time for the remaining stops.
        stop: Readings of the last stop.
    """

    n_done: int
    n_stops: int
    left_s: float
    stop: StopReadings


class Choice(NamedTuple):
    """The next stop.

    Attributes:
        row: Its number among the stops.
        is_validation: Whether its readings are kept out of the fit.
        repeat: How often it was visited before.
        this_s: Expected duration.
        left_s: Expected time for all stops after it.
        record: What the journal shall hold of it beside the readings.
    """

    row: int
    is_validation: bool
    repeat: int
    this_s: float
    left_s: float
    record: Mapping[str, Any]


Chooser: TypeAlias = Callable[[Sequence[Mapping[str, Any]], Sequence[int]], Choice | None]
"""Takes the entries of the journal, and the stops that an instrument refused since the last of them; None ends the session."""


def in_turn(stops: Observations, rig: Rig, pace: Pace) -> Chooser:
    """Choose the stops of a plan one after another.

    Args:
        stops: In order.
        rig: The rig that is measured.
        pace: Times, speeds and number of readings.
    """
    expected_s = durations_s(stops, rig, pace)

    def choose(entries: Sequence[Mapping[str, Any]], refused: Sequence[int]) -> Choice | None:  # noqa: ARG001
        row = len(entries)
        if row >= len(stops):
            return None
        is_validation, repeat = bool(stops.is_validation[row]), int(stops.repeat[row])
        return Choice(row, is_validation, repeat, expected_s[row], sum(expected_s[row + 1 :]), {})

    return choose


def references_of(rig: Rig, instruments: Instruments) -> dict[str, list[float]]:
    """Present pose of each mover's arm (base_from_flange), from which displacements are counted.

    Returns: Position in metres and rotation vector in radians, by mover.
    """
    references = {}
    for mover in rig.movers:
        pose = instruments.arms[mover.name].read_pose(timeout_s=ANSWER_S).value
        references[mover.name] = [*pose.position_m, *pose.rotation_vector_rad]
    return references


def acquire(
    stops: Observations,
    rig: Rig,
    instruments: Instruments,
    journal: Journal,
    pace: Pace,
    on_stop: Callable[[Progress], None] | None = None,
    choose: Chooser | None = None,
    n_stops: int | None = None,
    on_refused: Callable[[Refused], None] | None = None,
) -> None:
    """Visit the stops that the journal does not hold yet, then return the arms to zero displacement.

    Args:
        stops: All stops of the session, in order (`estimator.acquisition.pace.stops_of`), or those to choose from.
        rig: The rig whose coils, sensors and movers the instruments serve.
        instruments: Open instruments behind the limits of the rig.
        journal: Its header holds the references; each stop is on disk before `on_stop` is called.
        pace: Times, speeds and number of readings.
        on_stop: Called after each stop.
        choose: Says which stop is next; by default all of them, in order.
        n_stops: Number of stops to report progress by; all by default.
        on_refused: Called when an instrument refuses to go to a stop that was chosen, beyond its limits; another one is chosen then.
    Raises:
        InvalidInput: A sensor gives no new reading, or the journal cannot be written.
        drivers.errors.DriverError: An instrument failed, or refused a stop of a plan or many in turn. A stop at which the current
            differs from the requested one is not recorded.
    """
    is_chosen, choose = choose is not None, choose or in_turn(stops, rig, pace)
    refused: list[int] = []
    begin_s, expected_s = time.monotonic(), 0.0
    visit = Visit(rig, instruments, pace, journal.header["references"], _session_time_s(journal) - begin_s)
    with _ending_without_current(instruments):
        while (choice := choose(journal.entries, refused)) is not None:
            try:
                visit.go_to(stops, choice.row)
            except BroughtToRest:  # whatever the stop
                raise
            except Refused as refusal:
                if not is_chosen or len(refused) + 1 >= MOST_REFUSED:
                    raise
                _LOG.warning("a stop was refused and is skipped: %s", refusal)
                refused.append(choice.row)
                if on_refused is not None:
                    on_refused(refusal)
                continue
            refused = []  # the record of the stop names them
            readings = replace(
                visit.read(stops, choice.row), is_validation=choice.is_validation, repeat=choice.repeat
            )
            journal.append({**readings.entry(), **choice.record})
            expected_s += choice.this_s
            if on_stop is not None:
                left_s = choice.left_s * (time.monotonic() - begin_s) / expected_s
                on_stop(Progress(len(journal.entries), n_stops or len(stops), left_s, readings))
    visit.return_home()


def _session_time_s(journal: Journal) -> float:
    """Present time since the session began; never before its last reading, even if the host's clock was set back."""
    if not journal.entries:
        return 0.0
    elapsed_s = time.time() - float(journal.header["begin_s"])
    last_stop = journal.entries[-1]
    return max(elapsed_s, float(last_stop.get("end_s") or last_stop["time_s"]))


@contextmanager
def _ending_without_current(instruments: Instruments) -> Iterator[None]:
    """Ramp all currents to zero at the end of the block, even if one supply fails.

    An error that ended the block is raised again. After an interruption, a supply that is not known to be off takes precedence:
    the operator must learn of it.
    """
    try:
        yield
    except Exception:
        _switch_off(instruments)
        raise
    except BaseException as interruption:
        if (failure := _switch_off(instruments)) is not None:
            raise failure from interruption
        raise
    if (failure := _switch_off(instruments)) is not None:
        raise failure


def _switch_off(instruments: Instruments) -> Exception | None:
    """Ramp all currents to zero; return the first error, if any."""
    first_error: Exception | None = None
    for name, source in instruments.sources.items():
        try:
            source.output_off(timeout_s=source.longest_off_s)
        except Exception as error:
            _LOG.critical("%s is not known to be off: %s", name, error)
            first_error = first_error or error
    return first_error

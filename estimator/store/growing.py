"""Entries of the journal of a session that is being measured; `estimator.store.session` turns the complete journal into arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

from estimator.errors import InvalidInput
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.state import rig_state
from estimator.store.journal import Entry
from estimator.tensors import Tensor, torch
from estimator.units import LARGEST

GROWING = "coilcal growing session"
SCHEMA_VERSION = 1

Numbers = Sequence[float]


@dataclass(frozen=True)
class StopReadings:
    """Readings of all instruments at one stop; all times count from the beginning of the session.

    Attributes:
        time_s: Mean time of the field readings.
        current_A: Commanded current of each coil.
        motion: The six numbers of each mover's columns, as measured.
        field_T: Mean of each component, by sensor; NaN if out of range.
        is_validation: Whether the stop is kept out of the fit.
        repeat: Number of the visit.
        measured_A: Current measured by the supply, by coil.
        sd_T: Standard deviation of the single readings, by sensor.
        n_readings: Number of readings averaged.
        is_settled: Whether the field had settled.
        delay_s: Mean delay of the readings relative to the fastest one, by instrument with its own clock.
        temperature_C: Temperature of each coil and sensor with a thermometer; NaN if that gave no number.
        n_gaps: How often each sensor lost readings between those that were averaged.
        measured_s: When each of `measured_A` arrived.
        begin_s: End of the previous stop, or start of the run.
        end_s: When all instruments had been read.
        answer_s: Time from question to answer, by instrument: the highest age of a reading on arrival.
    """

    time_s: float
    current_A: Numbers
    motion: Mapping[str, Numbers]
    field_T: Mapping[str, Numbers]
    is_validation: bool
    repeat: int
    measured_A: Mapping[str, float] = field(default_factory=dict)
    sd_T: Mapping[str, Numbers] = field(default_factory=dict)
    n_readings: int = 1
    is_settled: bool = True
    delay_s: Mapping[str, float] = field(default_factory=dict)
    temperature_C: Mapping[str, float] = field(default_factory=dict)
    n_gaps: Mapping[str, int] = field(default_factory=dict)
    measured_s: Mapping[str, float] = field(default_factory=dict)
    begin_s: float | None = None
    end_s: float | None = None
    answer_s: Mapping[str, float] = field(default_factory=dict)

    def entry(self) -> Entry:
        """Entry of the journal, with None for NaN.

        Raises:
            InvalidInput: A number is beyond those that a session may hold.
        """
        entry = {
            **asdict(self),
            "field_T": {name: _nulls(field_T) for name, field_T in self.field_T.items()},
            "sd_T": {name: _nulls(sd_T) for name, sd_T in self.sd_T.items()},
            "temperature_C": dict(
                zip(self.temperature_C, _nulls(list(self.temperature_C.values())), strict=True)
            ),
        }
        for name, value in entry.items():
            for number in _numbers_in(value):
                if not abs(number) <= LARGEST:
                    rule = f"{name} of a reading must hold numbers between {-LARGEST:g} and {LARGEST:g}"
                    raise InvalidInput(f"{rule}; received {number:g}")
        return entry


def new_header(
    rig: Rig, source: str, plan: str, references: Mapping[str, Numbers], n_stops: int = 0
) -> Entry:
    """First entry of a session's journal.

    Args:
        rig: The rig to measure.
        source: Origin of the readings, in words.
        plan: Digest of the stops to visit; a resumed run must have the same.
        references: Position and rotation vector of each mover's flange at zero displacement (base_from_flange).
        n_stops: Number of stops in the plan; 0 if unknown.
    """
    now = datetime.now(UTC)
    return {
        "kind": GROWING,
        "schema_version": SCHEMA_VERSION,
        "created": now.isoformat(timespec="seconds"),
        "begin_s": now.timestamp(),
        "source": source,
        "rig": rig_state(rig),
        "rig_hash": rig.hash,
        "plan": plan,
        "n_stops": n_stops,
        "references": {name: list(pose) for name, pose in references.items()},
    }


def observations_of(entries: Sequence[Mapping[str, Any]], rig: Rig) -> Observations:
    """Observations from the entries of some stops, one row for each sensor that was read."""
    rows = [(stop, i) for stop in entries for i, s in enumerate(rig.sensors) if s.name in stop["field_T"]]

    def column(values: list[Any], width: int = 0) -> Tensor:
        shape = (len(rows), width) if width else (len(rows),)
        return torch.tensor(values, dtype=torch.float64).reshape(shape)

    # Journals of earlier versions hold no temperatures, and a thermometer may have been added while a session was interrupted.
    temperatures_C = [stop.get("temperature_C", {}) for stop, _ in rows]
    measured = sorted({name for by_name in temperatures_C for name in by_name})
    fields_T = [_numbers(stop["field_T"][rig.sensors[i].name]) for stop, i in rows]
    return Observations(
        column([stop["time_s"] for stop, _ in rows]),
        torch.tensor([i for _, i in rows], dtype=torch.int64),
        column([stop["current_A"] for stop, _ in rows], len(rig.coils)),
        {mover.name: column([stop["motion"][mover.name] for stop, _ in rows], 6) for mover in rig.movers},
        column(fields_T, 3),
        torch.tensor([stop["is_validation"] for stop, _ in rows], dtype=torch.bool),
        torch.tensor([stop["repeat"] for stop, _ in rows], dtype=torch.int64),
        {name: column(_numbers([by_name.get(name) for by_name in temperatures_C])) for name in measured},
        current_measured_A=_measured_A([stop for stop, _ in rows], rig),
    )


def entries_of(readings: Observations, rig: Rig) -> list[Entry]:
    """Entries for the stops of readings: those of one time are one stop. The inverse of `observations_of`, but for temperatures."""
    stops = []
    for time_s in readings.time_s.unique().tolist():
        own = (readings.time_s == time_s).nonzero().flatten().tolist()
        row, named = own[0], [rig.sensors[int(readings.sensor[i])].name for i in own]
        stop = StopReadings(
            time_s,
            readings.current_A[row].tolist(),
            {name: columns[row].tolist() for name, columns in readings.motion.items()},
            {name: readings.field_sensor_T[i].tolist() for name, i in zip(named, own, strict=True)},
            bool(readings.is_validation[row]),
            int(readings.repeat[row]),
        )
        stops.append(stop.entry())
    return stops


def _measured_A(stops: Sequence[Mapping[str, Any]], rig: Rig) -> Tensor | None:
    """Currents measured by the supplies, by coil; None if there are none."""
    currents_A = [
        _numbers([stop.get("measured_A", {}).get(coil.name) for coil in rig.coils]) for stop in stops
    ]
    measured_A = torch.tensor(currents_A, dtype=torch.float64).reshape(len(stops), len(rig.coils))
    return None if bool(measured_A.isnan().all()) else measured_A


def load_so_far(
    entries: Sequence[Mapping[str, Any]], coils: Sequence[str], now_s: float
) -> dict[str, list[tuple[float, float]]]:
    """History of the current in each coil until now, from which its self-heating follows (`drivers.safety.CoilLoad`).

    The history errs on the warm side. While a stop is prepared, the larger of its current and the previous one counts. An interrupted run
    counts as continued after its last entry, with the largest current so far, for as long as the longest stop took. After that, and
    between runs, no current flowed.

    Args:
        entries: Entries of a journal, without its header.
        coils: Names of the rig's coils, in order.
        now_s: Time since the session began.
    Returns: By coil, intervals as pairs of duration in seconds and current in ampere, oldest first; the coil was cold before.

    Examples:
        >>> stop = {"time_s": 4.5, "begin_s": 0.0, "end_s": 5.0, "current_A": [3.0]}
        >>> load_so_far([stop], ["coil1"], 60.0)
        {'coil1': [(5.0, 3.0), (5.0, 3.0), (50.0, 0.0)]}
    """
    intervals: dict[str, list[tuple[float, float]]] = {name: [] for name in coils}
    largest_A, previous_A = [0.0] * len(coils), [0.0] * len(coils)
    end_s, longest_s = 0.0, 0.0

    def add(duration_s: float, currents_A: Sequence[float]) -> None:
        for name, current_A in zip(coils, currents_A, strict=True):
            if duration_s > 0.0:
                intervals[name].append((duration_s, current_A))

    def add_pause(until_s: float) -> None:
        unknown_s = min(until_s - end_s, longest_s)
        add(unknown_s, largest_A)
        add(until_s - end_s - unknown_s, [0.0] * len(coils))

    for stop in entries:
        if (stop.get("begin_s") or end_s) > end_s:
            add_pause(stop["begin_s"])
            end_s, previous_A = stop["begin_s"], [0.0] * len(coils)
        begin_s, end_s = end_s, stop.get("end_s") or stop["time_s"]
        at_most_A = [max(abs(a), abs(b)) for a, b in zip(previous_A, stop["current_A"], strict=True)]
        add(end_s - begin_s, at_most_A)
        previous_A = stop["current_A"]
        largest_A = [max(abs(a), b) for a, b in zip(previous_A, largest_A, strict=True)]
        longest_s = max(longest_s, end_s - begin_s)
    add_pause(now_s)
    return intervals


def _numbers_in(value: Any) -> Iterator[float]:
    """All numbers of a part of an entry."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, Sequence) and not isinstance(value, str):
        for part in value:
            yield from _numbers_in(part)
    elif isinstance(value, float | int):
        yield value


def _nulls(values: Numbers) -> list[float | None]:
    return [None if math.isnan(value) else float(value) for value in values]


def _numbers(values: Sequence[float | None]) -> list[float]:
    return [math.nan if value is None else value for value in values]

"""A session that is being measured: a journal with a record for each stop, until it is whole and becomes arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

import torch
from torch import Tensor

from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.state import rig_state
from estimator.store.journal import Record

GROWING = "coilcal growing session"
SCHEMA_VERSION = 1

Numbers = Sequence[float]


@dataclass(frozen=True)
class StopRecord:
    """What was read at one stop; numbers that are not known are None in the journal.

    Attributes:
        time_s: When the field was read, on average, since the session began.
        current_A: Commanded current of each coil.
        motion: Per mover the six numbers of its columns, as measured.
        field_T: Mean of each component by sensor; NaN where it was out of range.
        is_validation: Kept out of the fit.
        repeat: Number of the visit.
        measured_A: What the supplies measured meanwhile, by coil.
        sd_T: Scatter of the single readings, by sensor.
        n_readings: That were averaged.
        is_settled: Whether the field had come to rest.
        delay_s: How late the readings of instruments with clocks of their own arrive, beyond the quickest of them.
        temperature_C: Of each coil and sensor that has a thermometer; NaN where that gave no number.
        n_gaps: How often each sensor lost readings between those that were averaged.
        measured_s: When each of `measured_A` arrived, since the session began.
        begin_s: When the stop before had ended, or the run began, since the session began.
        end_s: When all was read.
        answer_s: From question to answer, by instrument: a reading is not older when it arrives.
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

    def to_json(self) -> Record:
        """For the journal."""
        return {
            **asdict(self),
            **{key: {n: _nulls(v) for n, v in getattr(self, key).items()} for key in ("field_T", "sd_T")},
            "temperature_C": dict(
                zip(self.temperature_C, _nulls(list(self.temperature_C.values())), strict=True)
            ),
        }


def new_header(
    rig: Rig, source: str, plan: str, references: Mapping[str, Numbers], n_stops: int = 0
) -> Record:
    """First record of a session.

    Args:
        rig: That is measured.
        source: Where the readings come from, in words.
        plan: Digest of the stops to visit, by which a resumed run knows that they are the same.
        references: Per mover base_from_flange where displacements are zero, as six numbers.
        n_stops: That the plan has; 0 where nobody knows.
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


def observations_of(records: Sequence[Mapping[str, Any]], rig: Rig) -> Observations:
    """Readings of some stops, one row for each sensor that was read."""
    rows = [(one, i) for one in records for i, s in enumerate(rig.sensors) if s.name in one["field_T"]]

    def column(values: list[Any], width: int = 0) -> Tensor:
        shape = (len(rows), width) if width else (len(rows),)
        return torch.tensor(values, dtype=torch.float64).reshape(shape)

    # Journals of earlier versions know of no temperatures, and a thermometer may have been added while a session was interrupted.
    warmth = [one.get("temperature_C", {}) for one, _ in rows]
    felt = sorted({name for one in warmth for name in one})
    fields = [_numbers(one["field_T"][rig.sensors[i].name]) for one, i in rows]
    return Observations(
        column([one["time_s"] for one, _ in rows]),
        torch.tensor([i for _, i in rows], dtype=torch.int64),
        column([one["current_A"] for one, _ in rows], len(rig.coils)),
        {mover.name: column([one["motion"][mover.name] for one, _ in rows], 6) for mover in rig.movers},
        column(fields, 3),
        torch.tensor([one["is_validation"] for one, _ in rows], dtype=torch.bool),
        torch.tensor([one["repeat"] for one, _ in rows], dtype=torch.int64),
        {name: column(_numbers([one.get(name) for one in warmth])) for name in felt},
        current_measured_A=_measured_A([one for one, _ in rows], rig),
    )


def _measured_A(records: Sequence[Mapping[str, Any]], rig: Rig) -> Tensor | None:
    """What the supplies measured, by coil; None where there is no supply."""
    found = [_numbers([one.get("measured_A", {}).get(coil.name) for coil in rig.coils]) for one in records]
    measured_A = torch.tensor(found, dtype=torch.float64).reshape(len(records), len(rig.coils))
    return None if bool(measured_A.isnan().all()) else measured_A


def load_so_far(
    records: Sequence[Mapping[str, Any]], coils: Sequence[str], now_s: float
) -> dict[str, list[tuple[float, float]]]:
    """What flowed in each coil until now, for whoever keeps count of how warm a coil is by its own current.

    While a stop is prepared, the greater of its current and the one before flows at most. A run that was interrupted may have gone on after
    its last record: with the largest current so far, for as long as the longest stop took. After that, and between runs, nothing flowed.

    Args:
        records: Of a journal.
        coils: Of its rig, in order.
        now_s: Since the session began.
    Returns: By coil, spells of a duration in seconds and a current in ampere, oldest first; a cold coil began with them.

    Examples:
        >>> stop = {"time_s": 4.5, "begin_s": 0.0, "end_s": 5.0, "current_A": [3.0]}
        >>> load_so_far([stop], ["coil1"], 60.0)
        {'coil1': [(5.0, 3.0), (5.0, 3.0), (50.0, 0.0)]}
    """
    spells: dict[str, list[tuple[float, float]]] = {name: [] for name in coils}
    largest_A, before_A = [0.0] * len(coils), [0.0] * len(coils)
    end_s, longest_s = 0.0, 0.0

    def add(duration_s: float, current_A: Sequence[float]) -> None:
        for name, one_A in zip(coils, current_A, strict=True):
            if duration_s > 0.0:
                spells[name].append((duration_s, one_A))

    def add_pause(until_s: float) -> None:
        unknown_s = min(until_s - end_s, longest_s)
        add(unknown_s, largest_A)
        add(until_s - end_s - unknown_s, [0.0] * len(coils))

    for one in records:
        if (one.get("begin_s") or end_s) > end_s:
            add_pause(one["begin_s"])
            end_s, before_A = one["begin_s"], [0.0] * len(coils)
        begin_s, end_s = end_s, one.get("end_s") or one["time_s"]
        add(end_s - begin_s, [max(abs(a), abs(b)) for a, b in zip(before_A, one["current_A"], strict=True)])
        before_A = one["current_A"]
        largest_A = [max(abs(a), b) for a, b in zip(before_A, largest_A, strict=True)]
        longest_s = max(longest_s, end_s - begin_s)
    add_pause(now_s)
    return spells


def _nulls(values: Numbers) -> list[float | None]:
    return [None if math.isnan(value) else float(value) for value in values]


def _numbers(values: Sequence[float | None]) -> list[float]:
    return [math.nan if value is None else value for value in values]

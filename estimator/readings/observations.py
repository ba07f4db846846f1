"""Readings of a session as tensors: what a plan, a simulation or an import yields, and what a fit consumes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from jaxtyping import Bool, Float, Int

from estimator.readings.segments import segments_by_pauses
from estimator.tensors import Tensor, torch

SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True)
class Observations:
    """Readings of a session as tensors; one row is one reading of one sensor.

    Attributes:
        time_s: Time of the reading since a fixed but arbitrary instant.
        sensor: Index into the rig's sensors.
        current_A: Commanded or measured current per coil, positive out of the red terminal.
        motion: Per mover the six columns of `Mover.columns`.
        field_sensor_T: Measured components in the sensor's frame; NaN where a component was not measured.
        is_validation: Rows kept out of the fit.
        repeat: Number of the repeat of a setting; 0 if settings are not repeated.
        temperature_C: Temperature by name of sensor or coil, if it was recorded.
        whole: The session from which these readings were selected, in order of time; None if they are all of it.
        chosen: Rows of these readings in `whole`.
        current_measured_A: Current that the supplies measured at each reading; NaN for a missing value, None if it was not read.
        recorded_segment: Number of the segment of each reading, where the session says it (`segment`).
        rows_late: Rows by which fields were recorded late; `realigned` has undone it.
        late_since_h: Time since the session began, from which on they were late.
        as_recorded: These readings as they were recorded; None where nothing was undone.
        line: Line of the file from which each reading was imported; None where there is no such file.
    """

    time_s: Float[Tensor, " reading"]
    sensor: Int[Tensor, " reading"]
    current_A: Float[Tensor, "reading coil"]
    motion: Mapping[str, Float[Tensor, "reading 6"]]
    field_sensor_T: Float[Tensor, "reading 3"]
    is_validation: Bool[Tensor, " reading"]
    repeat: Int[Tensor, " reading"]
    temperature_C: Mapping[str, Float[Tensor, " reading"]]
    whole: Observations | None = field(default=None, repr=False)
    chosen: Int[Tensor, " reading"] | None = field(default=None, repr=False)
    current_measured_A: Float[Tensor, "reading coil"] | None = field(default=None, repr=False)
    recorded_segment: Int[Tensor, " reading"] | None = field(default=None, repr=False)
    rows_late: int = 0
    late_since_h: float = 0.0
    as_recorded: Observations | None = field(default=None, repr=False)
    line: Int[Tensor, " reading"] | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls,
        current_A: Float[Tensor, "reading coil"],
        motion: Mapping[str, Float[Tensor, "reading 6"]] | None = None,
        field_sensor_T: Float[Tensor, "reading 3"] | None = None,
        **more: Any,
    ) -> Observations:
        """Readings of one sensor a second apart, none of them repeated or kept out of the fit, unless said otherwise.

        Args:
            current_A: Commanded current per coil.
            motion: Per mover its six columns.
            field_sensor_T: Measured components; nothing by default.
            more: Other attributes.
        Examples:
            >>> len(Observations.of(torch.zeros(3, 1)))
            3
        """
        zeros = torch.zeros(len(current_A), dtype=torch.int64, device=current_A.device)
        unmeasured_T = torch.full((len(zeros), 3), torch.nan, dtype=torch.float64, device=zeros.device)
        usual = {
            "time_s": torch.arange(len(zeros), dtype=torch.float64, device=zeros.device),
            "sensor": zeros,
            "field_sensor_T": unmeasured_T if field_sensor_T is None else field_sensor_T,
            "is_validation": zeros.bool(),
            "repeat": zeros,
            "temperature_C": {},
        }
        return cls(**{**usual, **more, "current_A": current_A, "motion": motion or {}})

    def __len__(self) -> int:
        return self.time_s.shape[0]

    @property
    def dtype(self) -> torch.dtype:
        """Precision in which currents and poses are kept, and in which predictions of these readings are computed."""
        return self.current_A.dtype

    @property
    def device(self) -> torch.device:
        """Device that holds the readings, and on which models of them compute."""
        return self.current_A.device

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Observations:
        """These readings, with the history of their session, on another device or in another precision. Models of them compute there too.

        Times and measured fields keep their precision: seconds of a calendar, and small differences from a prediction, need it.

        Examples:
            >>> single = Observations.of(torch.zeros(1, 3, dtype=torch.float64)).to(dtype=torch.float32)
            >>> single.current_A.dtype, single.time_s.dtype
            (torch.float32, torch.float64)
        """
        device, dtype = device or self.device, dtype or self.dtype
        if (torch.empty(0, device=device).device, dtype) == (self.device, self.dtype):
            return self

        def moved(other: Observations | None) -> Observations | None:
            return None if other is None else other.to(device, dtype)

        return self._each(
            lambda values: values.to(device),
            lambda values: values.to(device, dtype),
            whole=moved(self.whole),
            chosen=None if self.chosen is None else self.chosen.to(device),
            as_recorded=moved(self.as_recorded),
        )

    def rows(self, index: Bool[Tensor, " reading"] | Int[Tensor, " rows"]) -> Observations:
        """Select readings; they keep the history of their session."""
        return self._select(index, self.history, self.row[index])

    def instants_in_words(self, instants_h: Sequence[float]) -> str:
        """Hours since the first reading, in seconds; where times only count the readings, as of a file without times, in their numbers.

        Args:
            instants_h: One, or the first and the last of a while.
        """
        history = self.history
        instants_s = [SECONDS_PER_HOUR * at_h for at_h in instants_h]
        if torch.equal(history.time_s, torch.arange(len(history)).to(history.time_s)):
            numbers = [
                f"{math.ceil(instants_s[0]) + 1}",
                *(f"{math.floor(at_s) + 1}" for at_s in instants_s[1:]),
            ]
            return f"from reading {' to '.join(numbers)}{'' if len(numbers) > 1 else ' on'}"
        return f"{' to '.join(f'{at_s:.0f}' for at_s in instants_s)} s after the first reading"

    @cached_property
    def history(self) -> Observations:
        """The whole session in order of time, also for a selection: earlier currents may affect a reading."""
        if self.whole is not None:
            return self.whole
        return self._select(torch.argsort(self.time_s, stable=True), None, None)

    @property
    def pace_s(self) -> float:
        """Mean time from one reading of the whole session to the next; 1 s where nothing tells it."""
        time_s = self.history.time_s
        return float((time_s[-1] - time_s[0]) / max(len(time_s) - 1, 1)) or 1.0

    @cached_property
    def row(self) -> Int[Tensor, " reading"]:
        """Row of each reading in `history`."""
        if self.chosen is not None:
            return self.chosen
        return torch.argsort(torch.argsort(self.time_s, stable=True))

    @cached_property
    def segment(self) -> Int[Tensor, " reading"]:
        """Number of the file, day or plane before which everything was set up anew: as recorded, else by long pauses of the session."""
        if self.recorded_segment is not None:
            return self.recorded_segment
        return segments_by_pauses(self.history.time_s)[self.row]

    def _select(self, index: Tensor, whole: Observations | None, chosen: Tensor | None) -> Observations:
        return self._each(
            lambda values: values[index],
            lambda values: values[index],
            whole=whole,
            chosen=chosen,
            as_recorded=None if self.as_recorded is None else self.as_recorded.rows(index),
            line=None if self.line is None else self.line[index.to(self.line.device)],
        )

    def _each(
        self, read: Callable[[Tensor], Tensor], setting: Callable[[Tensor], Tensor], **others: Any
    ) -> Observations:
        """These readings with every column changed, and other attributes replaced.

        Args:
            read: Changes what was read: times, fields, flags.
            setting: Changes currents and motions.
            others: Attributes to replace.
        """
        measured_A, segment = self.current_measured_A, self.recorded_segment
        return replace(
            self,
            time_s=read(self.time_s),
            sensor=read(self.sensor),
            current_A=setting(self.current_A),
            motion={name: setting(motion) for name, motion in self.motion.items()},
            field_sensor_T=read(self.field_sensor_T),
            is_validation=read(self.is_validation),
            repeat=read(self.repeat),
            temperature_C={name: setting(values) for name, values in self.temperature_C.items()},
            current_measured_A=None if measured_A is None else setting(measured_A),
            recorded_segment=None if segment is None else read(segment),
            **others,
        )

    def realigned(self, rows_late: int, since_h: float = 0.0) -> Observations:
        """The readings with the poses and currents of earlier rows, where fields were recorded some rows late, sensor by sensor.

        A field that belongs to no row counts as not measured. Readings that have been realigned are first put back.

        Args:
            rows_late: Rows by which fields were late; negative where they were early.
            since_h: Time since the session began, from which on they were late; rows before stay.
        """
        if (rows_late, since_h) == (self.rows_late, self.late_since_h):
            return self
        recorded = self.as_recorded or self
        if rows_late == 0:
            return recorded
        history = recorded.history
        is_late = (history.time_s - history.time_s.min()) / SECONDS_PER_HOUR >= since_h
        source = torch.arange(len(history), device=self.device)
        for sensor in history.sensor.unique():
            own = (history.sensor == sensor).nonzero().flatten()
            place = torch.arange(len(own), device=self.device) - rows_late * is_late[own]
            source[own] = torch.where(
                (place >= 0) & (place < len(own)), own[place.clamp(0, len(own) - 1)], -1
            )
        is_orphan, source = source < 0, source.clamp(min=0)
        whole = replace(
            history,
            current_A=history.current_A[source],
            motion={name: motion[source] for name, motion in history.motion.items()},
            field_sensor_T=history.field_sensor_T.masked_fill(is_orphan[:, None], torch.nan),
            rows_late=rows_late,
            late_since_h=since_h,
            as_recorded=history,
        )
        own_T = recorded.field_sensor_T.masked_fill(is_orphan[recorded.row, None], torch.nan)
        return replace(
            recorded,
            current_A=whole.current_A[recorded.row],
            motion={name: motion[recorded.row] for name, motion in whole.motion.items()},
            field_sensor_T=own_T,
            whole=whole,
            chosen=recorded.row,
            rows_late=rows_late,
            late_since_h=since_h,
            as_recorded=recorded,
        )

    @property
    def alone(self) -> Observations:
        """These readings as a separate session, without the history of the one they were selected from."""
        return self._select(torch.arange(len(self), device=self.device), None, None)

    def followed_by(self, later: Observations) -> Observations:
        """Append later readings; temperatures and measured currents that only one of the two has are left out.

        Segments stay as either of the two records them, and fields in the rows in which they were recorded.
        """
        if self.as_recorded is not None:
            return self.as_recorded.followed_by(later)

        def joined(earlier_values: Tensor, later_values: Tensor) -> Tensor:
            return torch.cat((earlier_values, later_values))

        return Observations(
            joined(self.time_s, later.time_s),
            joined(self.sensor, later.sensor),
            joined(self.current_A, later.current_A),
            {name: joined(motion, later.motion[name]) for name, motion in self.motion.items()},
            joined(self.field_sensor_T, later.field_sensor_T),
            joined(self.is_validation, later.is_validation),
            joined(self.repeat, later.repeat),
            {
                name: joined(values, later.temperature_C[name])
                for name, values in self.temperature_C.items()
                if name in later.temperature_C
            },
            current_measured_A=(
                None
                if self.current_measured_A is None or later.current_measured_A is None
                else joined(self.current_measured_A, later.current_measured_A)
            ),
            recorded_segment=(
                None
                if self.recorded_segment is None and later.recorded_segment is None
                else joined(self.segment, later.segment)
            ),
        )

    @property
    def calibration(self) -> Observations:
        """The readings used by a fit."""
        return self.rows(~self.is_validation)

    @property
    def validation(self) -> Observations:
        """The readings kept out of a fit; may be empty."""
        return self.rows(self.is_validation)

    @property
    def is_measured(self) -> Bool[Tensor, "reading 3"]:
        """Which components were measured."""
        return ~torch.isnan(self.field_sensor_T)

    def with_field(self, field_sensor_T: Float[Tensor, "reading 3"]) -> Observations:
        """These readings with other field values, in T in the frames of their sensors."""
        return replace(self, field_sensor_T=field_sensor_T)

    def with_validation(self, is_validation: Bool[Tensor, " reading"]) -> Observations:
        """These readings with another split into those for calibration and those for validation."""
        return replace(self, is_validation=is_validation)

"""One line of NDJSON: the readings of all sensors at one moment, checked against the rig before it is written anywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

from estimator.errors import InvalidInput
from estimator.json_files import json_object
from estimator.rig.rig import Rig
from estimator.service.problems import Problem, of_validation
from estimator.store.admission import MOST_REPEATS
from estimator.store.growing import StopReadings
from estimator.units import LARGEST

MOST_LINES = 10_000  # of one request
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Triple = Annotated[list[Number | None], Field(min_length=3, max_length=3)]
Six = Annotated[list[Number], Field(min_length=6, max_length=6)]


class Reading(BaseModel, extra="forbid", strict=True):
    """What the sensors of a rig show at one moment, with currents and poses.

    `sequence` counts the readings of a session from 0. A reading that is sent again is not written again.
    """

    sequence: Annotated[
        int, Field(ge=0, le=MOST_REPEATS, description="Number of the reading, from 0, without gaps.")
    ]
    time_s: Annotated[Number, Field(description="Time since any fixed instant of the session.")]
    current_A: Annotated[
        dict[str, Number], Field(description="Of every coil; positive out of the red terminal.")
    ]
    motion: Annotated[dict[str, Six], Field(description="The six numbers of every mover, in SI.")] = {}
    field_T: Annotated[
        dict[str, Triple],
        Field(description="By sensor, in its frame; null for a component that was not measured."),
    ]
    measured_A: Annotated[dict[str, Number], Field(description="Currents that the supplies measured.")] = {}
    temperature_C: Annotated[dict[str, Number | None], Field(description="Of coils and sensors.")] = {}
    is_validation: Annotated[bool, Field(description="Keep this reading out of the fit.")] = False
    repeat: Annotated[int, Field(ge=0, le=MOST_REPEATS, description="Number of the repeat of a setting.")] = 0

    def entry(self, rig: Rig) -> dict[str, Any]:
        """This reading as an entry of the journal of a session."""

        def numbers(values: Sequence[float | None]) -> list[float]:
            return [math.nan if value is None else value for value in values]

        stop = StopReadings(
            time_s=self.time_s,
            current_A=[self.current_A[coil.name] for coil in rig.coils],
            motion=self.motion,
            field_T={name: numbers(values) for name, values in self.field_T.items()},
            is_validation=self.is_validation,
            repeat=self.repeat,
            measured_A=self.measured_A,
            temperature_C={
                name: math.nan if value is None else value for name, value in self.temperature_C.items()
            },
        )
        return stop.entry()


def readings_of(body: bytes, rig: Rig) -> list[Reading]:
    """The readings of a body in NDJSON.

    Raises:
        Problem: A line is no reading of the rig, or does not follow the one before; the place is its line.
    """
    lines = body.split(b"\n")
    if not lines[-1].strip():
        lines.pop()
    if not lines:
        raise Problem(422, "body", "must hold a reading in each line; it holds none", place="body")
    if len(lines) > MOST_LINES:
        raise Problem(413, "body", f"must hold at most {MOST_LINES} readings", len(lines), "body")
    readings = [_reading(line, f"body, line {number}") for number, line in enumerate(lines, start=1)]
    for number, (earlier, reading) in enumerate(zip([None, *readings], readings, strict=False), start=1):
        place = f"body, line {number}"
        if earlier is not None and reading.sequence != earlier.sequence + 1:
            rule = f"must be {earlier.sequence + 1}, one more than in the line before"
            raise Problem(422, "sequence", rule, reading.sequence, place)
        _check_names(reading, rig, place)
    return readings


def _reading(line: bytes, place: str) -> Reading:
    try:
        return Reading.model_validate(json_object(line, place))
    except InvalidInput as error:
        raise Problem(422, place, str(error).removeprefix(f"{place} ")) from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)
        raise of_validation([{**first[0], "loc": ("body", *first[0]["loc"])}], place) from None


def _check_names(reading: Reading, rig: Rig, place: str) -> None:
    coils, sensors = ([body.name for body in bodies] for bodies in (rig.coils, rig.sensors))
    movers = [mover.name for mover in rig.movers]
    _check("current_A", reading.current_A, coils, coils, place)
    _check("motion", reading.motion, movers, movers, place)
    _check("field_T", reading.field_T, sensors, [], place)
    _check("measured_A", reading.measured_A, coils, [], place)
    _check("temperature_C", reading.temperature_C, [*coils, *sensors], [], place)
    if not reading.field_T:  # one without a component is what a sensor beyond its range gives
        raise Problem(422, "field_T", "must name at least one sensor; it names none", place=place)


def _check(
    key: str, values: Mapping[str, object], known: Sequence[str], needed: Sequence[str], place: str
) -> None:
    for name in values:
        if name not in known:
            raise Problem(422, key, f"must name those of the rig ({', '.join(known) or 'none'})", name, place)
    missing = [name for name in needed if name not in values]
    if missing:
        raise Problem(422, key, f"must name all of the rig's; {', '.join(missing)} is missing", None, place)

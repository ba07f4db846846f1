"""The instruments of an open session, as its readings tell of them: sensors, movers, supplies that measure their current, thermometers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from estimator.rig.rig import Rig

Kind = Literal["sensor", "mover", "supply", "thermometer"]


@dataclass(frozen=True)
class Device:
    """What an instrument showed last.

    Attributes:
        kind: What it is.
        name: Sensor or mover that it is, coil that it feeds, or body whose temperature it measures.
        values: What it showed, in `unit`; None for a component out of range.
        unit: Unit of `values`: T, A or °C; m for the position of a mover, rad for the joints of one that reports these.
        commanded_A: Of a supply, the current that was asked for.
        n_readings: How often it was read.
        n_silent: Readings of the session since then, in which it is missing.
    """

    kind: Kind
    name: str
    values: list[float | None]
    unit: str
    commanded_A: float | None = None
    n_readings: int = 0
    n_silent: int = 0


def updated(devices: Sequence[Device], entries: Sequence[Mapping[str, Any]], rig: Rig) -> list[Device]:
    """The instruments after further entries of the journal, in the order in which they were met.

    Args:
        devices: The instruments before.
        entries: What was appended.
        rig: The rig of the session.
    """
    known = {(device.kind, device.name): device for device in devices}
    for entry in entries:
        known = {key: replace(device, n_silent=device.n_silent + 1) for key, device in known.items()}
        for device in _of_entry(entry, rig):
            key = device.kind, device.name
            n_before = known[key].n_readings if key in known else 0
            known[key] = replace(device, n_readings=n_before + 1)
    return list(known.values())


def _of_entry(entry: Mapping[str, Any], rig: Rig) -> Iterator[Device]:
    commanded_A = dict(zip((coil.name for coil in rig.coils), entry["current_A"], strict=True))
    for name, field_T in entry["field_T"].items():
        yield Device("sensor", name, list(field_T), "T")
    for mover in rig.movers:
        numbers = list(entry["motion"][mover.name])
        if mover.table is None:
            yield Device("mover", mover.name, numbers[:3], "m")
        else:
            yield Device("mover", mover.name, numbers, "rad")
    for name, measured_A in entry.get("measured_A", {}).items():
        yield Device("supply", name, [measured_A], "A", commanded_A[name])
    for name, temperature_C in entry.get("temperature_C", {}).items():
        yield Device("thermometer", name, [temperature_C], "°C")

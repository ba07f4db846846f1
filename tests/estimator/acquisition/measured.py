"""A session that is measured by devices in memory."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch

from estimator.acquisition.acquire import acquire, references_of
from estimator.acquisition.pace import Pace, digest_of
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.growing import new_header
from estimator.store.journal import Journal
from estimator.store.session import load_session
from tests.drivers.memory import MemoryArm, MemorySensor, MemorySource

PACE = Pace(0.0, 6, 0.05, {"arm1": 10.0}, {"coil1": 100.0})


PLAN = """\
schema_version: 1
name: three stops
settle_s: 0.01
stops:
- {arm1: {x_mm: 10}, current_A: {coil1: 3}}
- {arm1: {x_mm: 10}, current_A: {coil1: -3}}
- {arm1: {x_mm: 10, y_mm: -20}, current_A: {coil1: -3}}
"""


class Scripted(MemorySensor):
    """Reads the values of a list, then repeats the last one."""

    def __init__(self, *values: Any) -> None:
        super().__init__()
        self.values = list(values)

    def read_field_T(self, *, timeout_s: float) -> Any:
        self.obey("read", timeout_s=timeout_s)
        value = self.values.pop(0) if len(self.values) > 1 else self.values[0]
        return self.counter.reading(*value) if isinstance(value[0], tuple) else self.counter.reading(value)


def rig_of_devices(sensor: MemorySensor | None = None) -> Any:
    return SimpleNamespace(
        sensors={"hall": sensor or MemorySensor()},
        sources={"coil1": MemorySource()},
        arms={"arm1": MemoryArm()},
        thermometers={},
    )


@dataclass
class Run:
    """A session that is measured by devices in memory."""

    folder: Path
    rig: Rig
    stops: Observations
    devices: Any = field(default_factory=rig_of_devices)

    def measure(
        self, *on_stop: Any, stops: Observations | None = None, pace: Pace = PACE, **more: Any
    ) -> list[Any]:
        """Visit the stops, or go on with them; the entries of the journal."""
        header = new_header(self.rig, "a test", digest_of(self.stops), references_of(self.rig, self.devices))
        is_begun = self.folder.exists()
        with Journal.resume(self.folder) if is_begun else Journal.create(self.folder, header) as journal:
            acquire(
                self.stops if stops is None else stops,
                self.rig,
                self.devices,
                journal,
                pace,
                *on_stop,
                **more,
            )
            return journal.entries

    def first_entry(self, sensor: MemorySensor, n_readings: int = 6) -> Any:
        """The journal's entry of one stop with a sensor."""
        self.devices, self.stops = rig_of_devices(sensor), self.stops.rows(torch.tensor([0]))
        return self.measure(pace=replace(PACE, n_readings=n_readings))[0]

    @property
    def readings(self) -> Observations:
        return load_session(self.folder).observations

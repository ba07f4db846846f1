"""A rig that measures itself without instruments: readings of a truth, put into a journal's entries stop by stop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from estimator.acquisition.acquire import Choice
from estimator.model.hide import with_hidden
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.autopilot import Autopilot
from estimator.planning.decision import Decided
from estimator.readings.observations import Observations
from estimator.recalibration.recheck import Recheck
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.store.growing import StopReadings


@dataclass
class World:
    """Field that each candidate of a session really has, and noise.

    Attributes:
        field_T: At every candidate and sensor, without noise.
    """

    pilot: Autopilot | Recheck
    field_T: torch.Tensor
    noise_T: float
    seed: int

    @classmethod
    def of(
        cls,
        rig: Rig,
        pilot: Autopilot | Recheck,
        truth: Mapping[str, float],
        noise_T: float,
        seed: int,
        hidden: Mapping[str, float] | None = None,
        stops: Observations | None = None,
    ) -> World:
        stops = pilot.stops if stops is None else stops
        real = with_hidden(rig.with_values(truth), stops, hidden or {})
        with torch.no_grad():
            field_T = MeasurementModel.build(real, stops).predict(nominal_tensors(real))
        return cls(pilot, field_T.expand(len(stops), 3).unflatten(0, (-1, len(rig.sensors))), noise_T, seed)

    def entry(self, choice: Choice, number: int) -> dict[str, Any]:
        """What a stop adds to the journal."""
        rig, settings = self.pilot.rig, self.pilot.settings
        rng = np.random.default_rng((self.seed, number))
        field_T = self.field_T[choice.row].numpy() + rng.normal(size=(len(rig.sensors), 3)) * self.noise_T
        readings = StopReadings(
            number + 0.5,
            settings.current_A[choice.row].tolist(),
            {mover.name: settings.motion[mover.name][choice.row].tolist() for mover in rig.movers},
            {sensor.name: field_T[i].tolist() for i, sensor in enumerate(rig.sensors)},
            choice.is_validation,
            choice.repeat,
            begin_s=float(number),
            end_s=number + 1.0,
        )
        return {**readings.entry(), **choice.record}

    def run(self) -> tuple[list[dict[str, Any]], Decided]:
        """The entries of a whole session, and why it ended."""
        entries: list[dict[str, Any]] = []
        while (choice := self.pilot.choose(entries)) is not None:
            entries.append(self.entry(choice, len(entries)))
        return entries, self.pilot.decide(entries)

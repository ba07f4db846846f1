"""A calibration that follows its readings: estimate, credible intervals and alarms after each of them.

Nothing is dropped: `update` takes all that it is given and returns when the estimate holds it, so whoever feeds it waits, or hands
over more at once (`estimator.store.follow` keeps on the disk what was not taken yet).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch.func import jacfwd

from estimator.errors import InvalidInput
from estimator.inference.running import RunningFit
from estimator.live.watch import Alarm, Watch
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

NINETY = 1.6448536269514722  # standard deviations on each side that hold 90 %
FEWEST_COMPONENTS = (
    3  # per free parameter, before readings are judged by what those before them led to expect
)


@dataclass(frozen=True)
class Interval:
    """A parameter in its SI unit, by Laplace: value, standard deviation, 90 % credible interval."""

    unit: str
    value: float
    sd: float
    low: float
    high: float


@dataclass(frozen=True)
class Estimate:
    """What is known after some readings.

    Attributes:
        n_readings: That the estimate holds.
        intervals: Of every free parameter.
        new_alarms: That the last readings raised.
        took_s: From the readings to this.
    """

    n_readings: int
    intervals: Mapping[str, Interval]
    new_alarms: tuple[Alarm, ...]
    took_s: float


class Stream:
    """The running calibration of one rig.

    Attributes:
        rig: With its priors.
        observations: All readings that a fit may see, in the order in which they came; None before the first.
        n_skipped: Readings for validation and readings without a component, which the fit does not see.

    Examples:
        >>> from estimator import load_plan, load_rig, simulate
        >>> rig = load_rig("configs/paper_simulation.yaml")
        >>> readings = simulate(rig, load_plan("configs/plans/paper_grid.yaml", rig), {}, seed=1)
        >>> stream = Stream(rig)
        >>> stream.update(readings.rows(torch.arange(40))).n_readings
        40
        >>> wide, narrow = (stream.update(readings.rows(torch.tensor([row]))) for row in (40, 41))
        >>> narrow.intervals["coil1.radius_m"].sd < 0.001
        True
    """

    def __init__(self, rig: Rig) -> None:
        if not rig.free:
            raise InvalidInput(
                f"rig must have at least one free parameter (a prior); rig {rig.name!r} has none"
            )
        self.rig = rig
        self.observations: Observations | None = None
        self.n_skipped = 0
        self._fit = RunningFit(rig)
        self._watch = Watch(rig)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All so far."""
        return tuple(self._watch.alarms)

    def update(self, readings: Observations) -> Estimate:
        """Take readings in, and say what is known now.

        Args:
            readings: New ones, later than all before.
        Raises:
            InvalidInput: A sensor would stand inside a winding.
        """
        begin_s = time.monotonic()
        usable = ~readings.is_validation & readings.is_measured.any(-1)
        self.n_skipped += int((~usable).sum())
        alarms: list[Alarm] = []
        if bool(usable.any()):
            new = readings.rows(usable)
            before = self.observations
            joined = new.alone if before is None else before.followed_by(new)
            innovation = self._fit.update(joined, len(new))
            self.observations = joined
            n_before = len(joined) - len(new)
            if 3 * n_before >= FEWEST_COMPONENTS * len(self.rig.free):
                alarms = self._watch.look(innovation, new, n_before + 1)
        n = 0 if self.observations is None else len(self.observations)
        return Estimate(n, self.intervals(), tuple(alarms), time.monotonic() - begin_s)

    def improve(self, values: Mapping[str, float]) -> None:
        """Start from other values as well, such as those of a fit from many starts, and keep what is better."""
        if self.observations is not None:
            start = self._fit.coordinates.vector(values)
            self._fit.refit(self.observations, start)

    def intervals(self) -> dict[str, Interval]:
        """Of every free parameter, now."""
        coordinates = self._fit.coordinates

        def reported(vector: torch.Tensor) -> torch.Tensor:
            values = coordinates.values(vector)
            return torch.stack([values[name] for name in coordinates.names])

        value = reported(self._fit.vector)
        slope = jacfwd(reported)(self._fit.vector)
        sd = (slope @ self._fit.covariance * slope).sum(-1).sqrt()
        return {
            parameter.name: Interval(parameter.unit, v, s, v - NINETY * s, v + NINETY * s)
            for parameter, v, s in zip(coordinates.parameters, value.tolist(), sd.tolist(), strict=True)
        }

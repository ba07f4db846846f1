"""A calibration that follows its readings: estimate, credible intervals and alarms after each update.

No reading is dropped: `update` returns once the estimate holds all readings it was given. A caller with faster readings passes more at once
(`estimator.store.follow` keeps on disk what was not taken yet).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from estimator.derivatives import jacobian_of
from estimator.effects.everywhere import tells_constant, with_everywhere
from estimator.inference.running import RunningFit
from estimator.live.watch import Alarm, Watch
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig

FEWEST_COMPONENTS = 3  # per free parameter, before new readings are compared with their prediction


@dataclass(frozen=True)
class Interval:
    """Value, standard deviation and 90 % credible interval of a parameter in its SI unit, by the Laplace approximation."""

    unit: str
    value: float
    sd: float
    low: float
    high: float


@dataclass(frozen=True)
class Estimate:
    """State of the calibration after some readings.

    Attributes:
        n_readings: Number of readings in the estimate.
        intervals: Interval of every free parameter.
        took_s: Time from the readings to this estimate.
        is_polished: Whether it is the maximum that a batch fit of these readings has, to 1e-6 standard deviations; else mostly to 0.05.
        missing: What no laboratory is without and these readings cannot tell from the fields of the coils, so that it is not fitted.
    """

    n_readings: int
    intervals: Mapping[str, Interval]
    took_s: float
    is_polished: bool
    missing: tuple[Cause, ...] = ()


class Stream:
    """The running calibration of one rig.

    Args:
        rig: The rig with its priors.
    Attributes:
        rig: As it is fitted: with the field of the room and the zeros of sensors that it does not mention, as soon as readings tell them
            from the fields of the coils, as `calibrate` fits it.
        observations: All readings of the fit, in order of arrival; None before the first.
        n_skipped: Number of readings left out of the fit: those for validation and those without a measured component.

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
        rig.check_free()
        self.rig = self._described = rig
        self.observations: Observations | None = None
        self.n_skipped = 0
        self._tells_constant: bool | None = None
        self._missing: tuple[Cause, ...] = ()
        self._fit = RunningFit(rig)
        self._watch = Watch(rig)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All alarms so far."""
        return tuple(self._watch.alarms)

    @property
    def values(self) -> dict[str, torch.Tensor]:
        """Every number of the rig at the estimate."""
        with torch.no_grad():
            return self._fit.coordinates.values(self._fit.vector)

    def update(self, readings: Observations) -> Estimate:
        """Add readings to the estimate.

        Args:
            readings: New readings, later than all before.
        Raises:
            InvalidInput: A sensor would stand inside a winding.
        """
        begin_s = time.monotonic()
        usable = ~readings.is_validation & readings.is_measured.any(-1)
        self.n_skipped += int((~usable).sum())
        if bool(usable.any()):
            new = readings.rows(usable)
            before = self.observations
            joined = new.alone if before is None else before.followed_by(new)
            innovation = self._fit.update(joined, len(new))
            self.observations = joined
            n_before = len(joined) - len(new)
            if 3 * n_before >= FEWEST_COMPONENTS * len(self.rig.free):
                self._watch.look(innovation, new, n_before + 1)
            self._fit_everywhere(joined)
        n = 0 if self.observations is None else len(self.observations)
        return Estimate(n, self.intervals(), time.monotonic() - begin_s, self.is_polished, self._missing)

    def _fit_everywhere(self, readings: Observations) -> None:
        """Begin anew with what no laboratory is without, or without it, where readings have begun or ceased to tell it."""
        if (tells := tells_constant(readings)) == self._tells_constant:
            return
        described, self._tells_constant = with_everywhere(self._described, readings), tells
        fitted, self._missing = described.rig, described.missing
        if fitted.free != self.rig.free:
            values = {name: float(value) for name, value in self.values.items()}
            self.rig, self._fit = fitted, RunningFit(fitted, values)
            self._fit.update(readings, len(readings))

    @property
    def can_polish(self) -> bool:
        """Whether `polish` may bring the estimate nearer to the batch fit."""
        return self.observations is not None and self._fit.can_polish

    @property
    def is_polished(self) -> bool:
        """Whether the estimate is that of a batch fit of all readings so far."""
        return self._fit.is_polished

    def polish(self) -> bool:
        """Use some milliseconds, while no reading waits, to bring the estimate nearer to the batch fit.

        Call it until `can_polish` is false, or `estimator.live.engine.ProcessorShare` allows no more.

        Returns: Whether the estimate changed; `intervals` tells the new one.

        Examples:
            >>> from estimator import load_plan, load_rig, simulate
            >>> rig = load_rig("configs/paper_simulation.yaml")
            >>> stream = Stream(rig)
            >>> estimate = stream.update(simulate(rig, load_plan("configs/plans/paper_grid.yaml", rig), {}, seed=1))
            >>> while stream.can_polish:
            ...     is_changed = stream.polish()
            >>> estimate.is_polished, stream.is_polished
            (False, True)
        """
        return self.observations is not None and self._fit.polish(self.observations)

    def improve(self, values: Mapping[str, float]) -> None:
        """Refit from other values, such as those of a fit from many starts, and keep the better optimum."""
        if self.observations is not None:
            start = self._fit.coordinates.vector({**self.rig.nominal_values(), **values})
            self._fit.refit(self.observations, start)

    def intervals(self) -> dict[str, Interval]:
        """Current interval of every free parameter."""
        coordinates = self._fit.coordinates

        def reported(vector: torch.Tensor) -> torch.Tensor:
            values = coordinates.values(vector)
            return torch.stack([values[name] for name in coordinates.names])

        value = reported(self._fit.vector)
        jacobian = jacobian_of(reported, self._fit.vector)
        sd = (jacobian @ self._fit.covariance * jacobian).sum(-1).sqrt()
        return {
            parameter.name: Interval(parameter.unit, v, s, v - HALF_WIDTH_90 * s, v + HALF_WIDTH_90 * s)
            for parameter, v, s in zip(coordinates.parameters, value.tolist(), sd.tolist(), strict=True)
        }

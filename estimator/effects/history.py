"""What happened before each reading of a session: readings, currents, moves and temperatures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from jaxtyping import Float, Int

from estimator.geometry.motion import base_from_motion
from estimator.readings.observations import SECONDS_PER_HOUR, Observations
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

MOST_TIME_STEPS = 300  # of a heating curve
SMALLEST_MOVE_M = 1e-9
LONG_AGO_S = 1e9  # before the first reading
LEAST_STEP = 1e-3  # of the largest current: less is the noise of currents that were read back


@dataclass(frozen=True)
class History:
    """Readings of a session, and what was before each.

    Attributes:
        rig: Names of coils, sensors and movers.
        observations: The readings; their `history` is the whole session.
    """

    rig: Rig
    observations: Observations

    def sensor_number(self, sensor: str) -> int:
        """Index of a sensor in the rig."""
        return [each.name for each in self.rig.sensors].index(sensor)

    def coil_number(self, coil: str) -> int:
        """Index of a coil in the rig."""
        return [each.name for each in self.rig.coils].index(coil)

    @cached_property
    def largest_current_A(self) -> float:
        """Largest commanded current of the session."""
        return max(float(self.observations.history.current_A.abs().max()), 1e-9)

    @cached_property
    def history_h(self) -> Float[Tensor, " history"]:
        """Time of each reading of the session since it began."""
        time_s = self.observations.history.time_s
        return (time_s - time_s.min()) / SECONDS_PER_HOUR

    @cached_property
    def duration_h(self) -> float:
        """Time from the first reading of the session to the last; at least a second."""
        time_s = self.observations.history.time_s
        return max(float(time_s.max() - time_s.min()), 1.0) / SECONDS_PER_HOUR

    def row_before(self, sensor: str) -> Int[Tensor, " history"]:
        """Row of the history of the reading that a sensor took before each; its own where none was."""
        history = self.observations.history
        own = (history.sensor == self.sensor_number(sensor)).nonzero().flatten()
        row = torch.arange(len(history), device=history.device)
        row[own[1:]] = own[:-1]
        return row

    def previous(self, sensor: str) -> tuple[Int[Tensor, " reading"], Float[Tensor, " reading"]]:
        """Row in the history of the reading that a sensor took before, and how long before; its own row and `LONG_AGO_S` where none was."""
        history, row = self.observations.history, self.row_before(sensor)
        ago_s = history.time_s - history.time_s[row]
        ago_s = torch.where(ago_s > 0.0, ago_s, LONG_AGO_S)
        return row[self.observations.row], ago_s[self.observations.row].to(history.dtype)

    def read_before(self, sensor: str) -> Int[Tensor, " reading"]:
        """Row in the history of the reading just before each one of a sensor, where that was of another sensor; -1 where it was not."""
        history = self.observations.history
        row = torch.arange(-1, len(history) - 1, device=history.device)
        is_own = history.sensor == self.sensor_number(sensor)
        return torch.where(is_own & ~is_own.roll(1) & (row >= 0), row, -1)[self.observations.row]

    def last_turn_A(self, coil: int) -> Float[Tensor, " reading"]:
        """Commanded current from which that of a coil last turned back; 0 before it first did. Every session comes from 0."""
        held_A = torch.nn.functional.pad(self.observations.history.current_A[:, coil], (1, 0))
        step_A = held_A.diff()
        rows = (step_A.abs() > LEAST_STEP * self.largest_current_A).nonzero().flatten()
        turns = rows[1:][step_A[rows].sign().diff() != 0.0]  # rows at which the current goes the other way
        n_before = torch.searchsorted(turns, torch.arange(len(step_A), device=turns.device), right=True)
        return torch.nn.functional.pad(held_A[turns], (1, 0))[n_before][self.observations.row]

    def _kelvin(self, celsius: Tensor, place: str) -> tuple[Tensor, Tensor]:
        """Temperatures above the mean of the session, 0 where none was read; and how far the coolest lies below that mean."""
        history_C = self.observations.history.temperature_C[place]
        known = history_C[~torch.isnan(history_C)]
        if not len(known):
            return torch.nan_to_num(celsius), history_C.new_zeros(())
        return torch.nan_to_num(celsius - known.mean()), known.mean() - known.min()

    def temperature_K(self, place: str) -> Float[Tensor, " reading"] | None:
        """Temperature of a coil or sensor above its mean over the session; None without a thermometer."""
        celsius = self.observations.temperature_C.get(place)
        return None if celsius is None else self._kelvin(celsius, place)[0]

    def warming_K(self, place: str) -> Float[Tensor, " reading"] | None:
        """Temperature of a coil or sensor above the coolest of the session; None without a thermometer."""
        celsius = self.observations.temperature_C.get(place)
        return None if celsius is None else torch.add(*self._kelvin(celsius, place))

    def lagged_K(self, place: str, tau_h: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch reading"] | None:
        """`temperature_K`, low-passed from the first reading on; None without a thermometer."""
        celsius = self.observations.history.temperature_C.get(place)
        if celsius is None:
            return None
        kelvin = self._kelvin(celsius, place)[0]
        return kelvin[0] + self._low_passed(kelvin - kelvin[0], tau_h)

    def heat_A2(self, coil: int, tau_h: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch reading"]:
        """Low-passed square of the commanded current; the time constant is that of the thermal mass."""
        return self._low_passed(self.observations.history.current_A[:, coil] ** 2, tau_h)

    def _low_passed(
        self, values: Float[Tensor, " history"], tau_h: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch reading"]:
        """Values of the history, each held until the next, through a low pass that begins at 0."""
        time_h = self.history_h.to(values.dtype)
        n_edges = min(len(time_h), MOST_TIME_STEPS) + 1
        edges = torch.linspace(0.0, self.duration_h, n_edges, dtype=time_h.dtype, device=time_h.device)
        bin_of = torch.searchsorted(edges[1:-1].contiguous(), time_h.contiguous(), right=True)
        held = torch.searchsorted(time_h.contiguous(), edges[:-1].contiguous(), right=True).clamp(min=1) - 1
        step_h = self.duration_h / (len(edges) - 1)
        remaining = torch.exp(-step_h / tau_h)[..., None]  # of what there was, after one step
        passed, reach = (1.0 - remaining) * values[held], 1
        while reach < len(held):  # of so many steps; twice as many each time
            earlier = remaining * passed[..., :-reach]
            passed = torch.cat((passed[..., :reach], passed[..., reach:] + earlier), dim=-1)
            remaining, reach = remaining.square(), 2 * reach
        return passed[..., bin_of[self.observations.row]]

    def moves_m(self, mover: str) -> Float[Tensor, "history 3"]:
        """Translation of the mover from each row of the session's history to the next; zero at the first."""
        motion = self.observations.history.motion[mover]
        here = base_from_motion(self.rig.mover(mover), motion).translation_m
        return torch.diff(here, dim=0, prepend=here[:1])

    def last_move_m(self, mover: str) -> Float[Tensor, "reading 3"]:
        """Translation of the mover by its last move; zero before it first moved."""
        step = self.moves_m(mover)
        has_moved = (step.abs() > SMALLEST_MOVE_M).any(-1)
        last = torch.cummax(torch.arange(len(step), device=step.device) * has_moved, dim=0).values
        return step[last][self.observations.row]

    def approach(self, mover: str) -> Float[Tensor, "reading 3"]:
        """Sign of the last move along each axis; 0 before the first."""
        step = self.moves_m(mover)
        sign = torch.where(step.abs() > SMALLEST_MOVE_M, torch.sign(step), torch.zeros_like(step))
        last = torch.arange(len(step), device=step.device)[:, None] * (sign != 0.0)
        return torch.gather(sign, 0, torch.cummax(last, dim=0).values)[self.observations.row]

"""The physical world of a simulated rig, in memory shared by the processes of the simulators.

No process updates it: it stores start and target of each current and motion, and a reader computes the present state.
`time.monotonic()` is one clock for all processes of a host.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from drivers.children import SPAWN
from drivers.protocols import FlangePose, Vector
from drivers.rotation import interpolate

ORIGIN = FlangePose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

ROOM_K, ROOM_SWING_K, ROOM_PERIOD_S = 295.15, 1.0, 1200.0
"""Mean, amplitude and period of the temperature of a room with air conditioning."""

_COIL_CELLS = 4
_MOTION_CELLS = 14


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The world at one moment: all that the field depends on.

    Attributes:
        time_s: Time since the world began.
        currents_A: Current in each coil.
        base_from_flange: Pose of each arm's flange, in the frame of its own base.
        coil_temperatures_K: Temperature of each coil.
        room_temperature_K: Temperature of everything else.
    """

    time_s: float
    currents_A: tuple[float, ...]
    base_from_flange: tuple[FlangePose, ...]
    coil_temperatures_K: tuple[float, ...]
    room_temperature_K: float


FieldFunction: TypeAlias = Callable[[Snapshot], Vector]
"""Field at the sensor, in tesla along its axes. Must be importable, because it is sent to another process."""


@dataclass(frozen=True, slots=True)
class CoilCircuit:
    """Electrical load of a coil on its supply, and its warming by ohmic losses.

    Attributes:
        resistance_ohm: Resistance with the leads.
        inductance_H: Inductance; with zero, the current follows at once.
        kelvin_per_W: Steady temperature rise above the room per watt (thermal resistance).
        thermal_time_constant_s: Time to reach 63 % of that rise.
    """

    resistance_ohm: float
    inductance_H: float
    kelvin_per_W: float = 1.0
    thermal_time_constant_s: float = 300.0

    @property
    def time_constant_s(self) -> float:
        """L / R."""
        return self.inductance_H / self.resistance_ohm

    def temperature_rise_K(self, start_K: float, current_A: float, elapsed_s: float) -> float:
        """Temperature rise above the room after a constant current; one heat capacity, one thermal resistance.

        Args:
            start_K: Rise at the start.
            current_A: Current that has flowed since.
            elapsed_s: Time since the start.

        Examples:
            >>> CoilCircuit(2.0, 0.0, kelvin_per_W=1.0, thermal_time_constant_s=100.0).temperature_rise_K(0.0, 3.0, 100.0)
            11.378
        """
        steady_K = self.kelvin_per_W * self.resistance_ohm * current_A**2
        return steady_K + (start_K - steady_K) * math.exp(-elapsed_s / self.thermal_time_constant_s)


class World:
    """Currents and temperatures of the coils and poses of the flanges.

    Examples:
        >>> world = World([CoilCircuit(resistance_ohm=2.0, inductance_H=0.0)])
        >>> world.drive(0, 1.5)
        >>> world.snapshot().currents_A
        (1.5,)
    """

    def __init__(self, circuits: Sequence[CoilCircuit], homes: Sequence[FlangePose] = (ORIGIN,)) -> None:
        """Start with all currents at zero, all coils at room temperature and each flange at its home."""
        self.circuits = tuple(circuits)
        self._n_arms = len(homes)
        self._start_s = time.monotonic()
        self._first_motion = _COIL_CELLS * len(self.circuits)
        self._cells = SPAWN.Array("d", self._first_motion + _MOTION_CELLS * self._n_arms)
        for arm, home in enumerate(homes):
            self._write_motion(arm, home, home, 0.0)

    def snapshot(self) -> Snapshot:
        """The world now."""
        with self._cells:
            # Before the lock, the time could lie before a start that another process writes.
            now_s = time.monotonic()
            currents_A = tuple(self._current_A(coil, now_s) for coil in range(len(self.circuits)))
            poses = tuple(self._pose(arm, now_s) for arm in range(self._n_arms))
            rises_K = [self._rise_K(coil, now_s) for coil in range(len(self.circuits))]
        time_s = now_s - self._start_s
        room_K = ROOM_K + ROOM_SWING_K * math.sin(2.0 * math.pi * time_s / ROOM_PERIOD_S)
        return Snapshot(time_s, currents_A, poses, tuple(room_K + rise_K for rise_K in rises_K), room_K)

    def drive(self, coil: int, current_A: float) -> None:
        """Let the current of a coil approach a target, with the time constant of its circuit."""
        with self._cells:
            now_s = time.monotonic()
            present_A, rise_K = self._current_A(coil, now_s), self._rise_K(coil, now_s)
            self._cells[self._coil(coil)] = [present_A, current_A, now_s, rise_K]

    def move(self, arm: int, target: FlangePose, duration_s: float) -> None:
        """Move a flange from its present pose to another one."""
        with self._cells:
            self._write_motion(arm, self._pose(arm, time.monotonic()), target, duration_s)

    def halt(self, arm: int) -> None:
        """Stop a flange at its present pose."""
        with self._cells:
            pose = self._pose(arm, time.monotonic())
            self._write_motion(arm, pose, pose, 0.0)

    def pose(self, arm: int) -> FlangePose:
        """Pose of a flange now."""
        with self._cells:
            return self._pose(arm, time.monotonic())

    def is_moving(self, arm: int) -> bool:
        """Whether a flange is moving."""
        with self._cells:
            begin_s, duration_s = self._cells[self._motion(arm)][12:]
        return bool(time.monotonic() < begin_s + duration_s)

    def _current_A(self, coil: int, now_s: float) -> float:
        first_A, target_A, begin_s, _ = self._cells[self._coil(coil)]
        time_constant_s = self.circuits[coil].time_constant_s
        decay = math.exp(-(now_s - begin_s) / time_constant_s) if time_constant_s > 0 else 0.0
        return float(target_A + (first_A - target_A) * decay)

    def _rise_K(self, coil: int, now_s: float) -> float:
        """Rise by the target current: the current settles in milliseconds, the temperature in minutes."""
        _, target_A, begin_s, start_K = self._cells[self._coil(coil)]
        return self.circuits[coil].temperature_rise_K(start_K, target_A, now_s - begin_s)

    def _pose(self, arm: int, now_s: float) -> FlangePose:
        cells = self._cells[self._motion(arm)]
        begin_s, duration_s = cells[12:]
        target = _pose(cells[6:12])
        if now_s >= begin_s + duration_s:
            return target
        return interpolate(_pose(cells[:6]), target, (now_s - begin_s) / duration_s)

    def _write_motion(self, arm: int, start: FlangePose, target: FlangePose, duration_s: float) -> None:
        poses = (
            *start.position_m,
            *start.rotation_vector_rad,
            *target.position_m,
            *target.rotation_vector_rad,
        )
        self._cells[self._motion(arm)] = [*poses, time.monotonic(), duration_s]

    def _coil(self, coil: int) -> slice:
        return slice(_COIL_CELLS * coil, _COIL_CELLS * (coil + 1))

    def _motion(self, arm: int) -> slice:
        first = self._first_motion + _MOTION_CELLS * arm
        return slice(first, first + _MOTION_CELLS)


def _pose(cells: Sequence[float]) -> FlangePose:
    x_m, y_m, z_m, x_rad, y_rad, z_rad = cells
    return FlangePose((x_m, y_m, z_m), (x_rad, y_rad, z_rad))

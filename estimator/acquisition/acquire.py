"""Visits the stops of a plan with real instruments: move, set currents, settle, average, write down, tell.

Instruments are seen as `drivers.protocols` only; whoever opens them puts the limits of the rig before them (`drivers.guarded`).
However a run ends, the currents are ramped to zero.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from statistics import fmean
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from drivers.errors import DeviceFault
from drivers.protocols import (
    CurrentSource,
    FieldSensor,
    FlangePose,
    Reading,
    ReadingFlag,
    RobotArm,
    Thermometer,
)
from estimator.acquisition.averages import average
from estimator.acquisition.clocks import DeviceClock
from estimator.acquisition.pace import ANSWER_S, Pace, durations_s
from estimator.frames import Transform, vector_from_rotation
from estimator.geometry.motion import flange_to_reach, motion_reached
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.growing import StopRecord
from estimator.store.journal import Journal
from estimator.units import ICE_POINT_K

_LOG = logging.getLogger(__name__)

STILL_M, STILL_RAD = (
    2e-5,
    1e-4,
)  # below the repeatability of the arms: one that was not told to move has not moved


@runtime_checkable
class Instruments(Protocol):
    """Open instruments by the name of what they serve; a `drivers.open.DeviceSet` is one."""

    sensors: dict[str, FieldSensor]
    sources: dict[str, CurrentSource]
    arms: dict[str, RobotArm]
    thermometers: dict[str, Thermometer]


@dataclass(frozen=True)
class Progress:
    """Told after each stop, once it is on the disk.

    Attributes:
        n_done: Stops that were visited, those of earlier runs included.
        n_stops: In the plan.
        left_s: Time that the others will take.
        stop: The last one.
    """

    n_done: int
    n_stops: int
    left_s: float
    stop: StopRecord


def references_of(rig: Rig, instruments: Instruments) -> dict[str, list[float]]:
    """Where each arm stands now; displacements count from there."""
    found = {}
    for mover in rig.movers:
        pose = instruments.arms[mover.name].read_pose(timeout_s=ANSWER_S).value
        found[mover.name] = [*pose.position_m, *pose.rotation_vector_rad]
    return found


def acquire(
    stops: Observations,
    rig: Rig,
    instruments: Instruments,
    journal: Journal,
    pace: Pace,
    on_stop: Callable[[Progress], None] | None = None,
) -> None:
    """Visit the stops that the journal does not hold yet, then bring the arms back to where displacements are zero.

    Args:
        stops: All of the session, in order (`estimator.acquisition.pace.stops_of`).
        rig: Names what the instruments serve.
        instruments: Open, within the limits of the rig.
        journal: Its header holds the references; each stop is on the disk before `on_stop` hears of it.
        pace: How.
        on_stop: Told after each stop.
    Raises:
        InvalidInput: A sensor gives no new reading, or the journal cannot be written.
        drivers.errors.DriverError: An instrument failed, or refused what is beyond its limits; a stop at which the current was not what was
            asked for is not written down.
    """
    expected_s = durations_s(stops, rig, pace)
    n_before = len(journal.records)
    begin_s = time.monotonic()
    references = {name: _transform(pose) for name, pose in journal.header["references"].items()}
    visit = _Visit(rig, instruments, pace, references, _time_since(journal) - begin_s)
    with _ending_without_current(instruments):
        for row in range(n_before, len(stops)):
            visit.go_to(stops, row)
            record = visit.read(stops, row)
            journal.append(record.to_json())
            if on_stop is not None:
                share = (time.monotonic() - begin_s) / sum(expected_s[n_before : row + 1])
                on_stop(Progress(row + 1, len(stops), share * sum(expected_s[row + 1 :]), record))
    visit.return_home()


class _Visit:
    """The state of a run: what was set last, so that nothing is sent twice."""

    def __init__(
        self,
        rig: Rig,
        instruments: Instruments,
        pace: Pace,
        references: Mapping[str, Transform],
        session_from_host_s: float,
    ) -> None:
        self._rig, self._instruments, self._pace, self._references = rig, instruments, pace, references
        self._session_from_host_s = session_from_host_s
        self._begin_s = time.monotonic()
        self._answer_s: dict[str, float] = {}
        self._motion: dict[str, Tensor] = {}
        self._stands: dict[str, FlangePose] = {}
        self._clocks: dict[str, DeviceClock] = {}
        self._current_A: dict[str, float] = {}

    def go_to(self, stops: Observations, row: int) -> None:
        """Move, then set the currents, then wait."""
        for mover in self._rig.movers:
            motion = stops.motion[mover.name][row]
            if mover.name not in self._motion or bool((motion != self._motion[mover.name]).any()):
                target = flange_to_reach(mover, motion[None], self._references[mover.name])
                self._move(mover.name, _flange_pose(target))
                self._motion[mover.name] = motion
        for i, coil in enumerate(self._rig.coils):
            current_A = float(stops.current_A[row, i])
            if coil.name in self._instruments.sources and self._current_A.get(coil.name) != current_A:
                ramp_s = (
                    abs(current_A - self._current_A.get(coil.name, 0.0)) / self._pace.slew_A_per_s[coil.name]
                )
                self._instruments.sources[coil.name].set_current_A(
                    current_A, timeout_s=2.0 * ramp_s + ANSWER_S
                )
                self._current_A[coil.name] = current_A
        time.sleep(self._pace.settle_s)

    def read(self, stops: Observations, row: int) -> StopRecord:
        """Average the field, then look where the arms and the currents are, and how warm it is."""
        averages = {
            name: average(sensor, name, self._pace, partial(self._taken_s, name))
            for name, sensor in self._instruments.sensors.items()
        }
        motion = {}
        for mover in self._rig.movers:
            pose = self._pose(mover.name)
            here = _transform([*pose.position_m, *pose.rotation_vector_rad])
            asked = stops.motion[mover.name][row][None]
            motion[mover.name] = motion_reached(mover, here, self._references[mover.name], asked)[0].tolist()
        flowing = {name: self._flowing(name) for name in self._instruments.sources}
        temperature_C = {
            name: thermometer.read_temperature_K(timeout_s=ANSWER_S).value - ICE_POINT_K
            for name, thermometer in self._instruments.thermometers.items()
        }
        begin_s, self._begin_s = self._begin_s, time.monotonic()
        shift_s = self._session_from_host_s
        return StopRecord(
            fmean(one.taken_s for one in averages.values()) + shift_s,
            stops.current_A[row].tolist(),
            motion,
            {name: one.mean_T.tolist() for name, one in averages.items()},
            bool(stops.is_validation[row]),
            int(stops.repeat[row]),
            {name: reading.value for name, reading in flowing.items()},
            {name: one.sd_T.tolist() for name, one in averages.items()},
            self._pace.n_readings,
            all(one.has_settled for one in averages.values()),
            {name: clock.delay_s for name, clock in self._clocks.items()},
            temperature_C,
            {name: one.n_gaps for name, one in averages.items()},
            {name: reading.host_monotonic_s + shift_s for name, reading in flowing.items()},
            begin_s + shift_s,
            self._begin_s + shift_s,
            self._answer_s | {name: one.answer_s for name, one in averages.items()},
        )

    def return_home(self) -> None:
        """Where the next session finds the arms as this one did."""
        for name, reference in self._references.items():
            self._move(name, _flange_pose(reference))

    def _flowing(self, name: str) -> Reading[float]:
        """What a supply measures, as long as it is what was asked for, as far as the supply itself can tell (`drivers.guarded` compares).

        Raises:
            DeviceFault: It is not, or not known.
        """
        asked_A = self._current_A.get(name, 0.0)
        with self._timed(name):
            reading = self._instruments.sources[name].read_current_A(timeout_s=ANSWER_S)
        # At zero a supply holds neither voltage nor current, whatever it says.
        if ReadingFlag.OVER_RANGE in reading.flags and asked_A != 0.0:
            raise DeviceFault(
                f"{name} must carry {asked_A:g} A; its supply has reached a limit and measures {reading.value:.4g} A"
            )
        if ReadingFlag.STALE in reading.flags or math.isnan(reading.value):
            raise DeviceFault(
                f"{name} must carry {asked_A:g} A; its supply does not measure what it carries now"
            )
        return reading

    def _pose(self, name: str) -> FlangePose:
        """Where an arm stands; the noise of its encoders makes no other place of one where it stood before."""
        with self._timed(name):
            reading = self._instruments.arms[name].read_pose(timeout_s=ANSWER_S)
        pose = reading.value
        self._taken_s(name, reading)
        known = self._stands.get(name)
        if (
            known is None
            or math.dist(pose.position_m, known.position_m) > STILL_M
            or math.dist(pose.rotation_vector_rad, known.rotation_vector_rad) > STILL_RAD
        ):
            self._stands[name] = pose
        return self._stands[name]

    def _move(self, name: str, target: FlangePose) -> None:
        arm, speed_m_per_s = self._instruments.arms[name], self._pace.speed_m_per_s[name]
        here = arm.read_pose(timeout_s=ANSWER_S).value
        way_m = math.dist(here.position_m, target.position_m)
        # A turn on the spot takes its time, too: half a circle at the slowest that arms are driven.
        timeout_s = 2.0 * way_m / speed_m_per_s + 10.0 + ANSWER_S
        self._stands.pop(name, None)
        arm.move_to(target, speed_m_per_s=speed_m_per_s, timeout_s=timeout_s)

    def _taken_s(self, name: str, reading: Reading[Any], asked_s: float = -math.inf) -> float:
        """When a reading was taken, on the host's clock: when it arrived, where the instrument has none; not before it was asked for."""
        if reading.device_time_s is None:
            return reading.host_monotonic_s
        clock = self._clocks.setdefault(name, DeviceClock())
        clock.add(reading.host_monotonic_s, reading.device_time_s, asked_s)
        return max(asked_s, clock.on_host_s(reading.device_time_s))

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        """Note how long an instrument takes to answer."""
        asked_s = time.monotonic()
        yield
        self._answer_s[name] = time.monotonic() - asked_s


def _time_since(journal: Journal) -> float:
    """When this run begins on the clock of the session: after its last reading, whatever the host's clock did meanwhile."""
    if not journal.records:
        return 0.0
    passed_s = time.time() - float(journal.header["begin_s"])
    last = journal.records[-1]
    return max(passed_s, float(last.get("end_s") or last["time_s"]))


@contextmanager
def _ending_without_current(instruments: Instruments) -> Iterator[None]:
    """Ramp all currents to zero at the end, even where one fails, without hiding the error that ended the block.

    An interruption is no error: a supply that is not known to be off is what the operator must hear of then.
    """
    try:
        yield
    except Exception:
        _switch_off(instruments)
        raise
    except BaseException as interruption:
        if (failed := _switch_off(instruments)) is not None:
            raise failed from interruption
        raise
    if (failed := _switch_off(instruments)) is not None:
        raise failed


def _switch_off(instruments: Instruments) -> Exception | None:
    """What went wrong first, if anything."""
    failed: Exception | None = None
    for name, source in instruments.sources.items():
        try:
            source.output_off(timeout_s=source.longest_off_s)
        except Exception as error:
            _LOG.critical("%s is not known to be off: %s", name, error)
            failed = failed or error
    return failed


def _transform(pose: list[float]) -> Transform:
    numbers = torch.tensor([pose], dtype=torch.float64)
    return Transform.from_pose(numbers[:, :3], numbers[:, 3:])


def _flange_pose(pose: Transform) -> FlangePose:
    x_m, y_m, z_m = pose.translation_m[0].tolist()
    x_rad, y_rad, z_rad = vector_from_rotation(pose.rotation)[0].tolist()
    return FlangePose((x_m, y_m, z_m), (x_rad, y_rad, z_rad))

"""Stops are visited in order, each is on disk before it is reported, and no current flows after a run, even one that failed."""

from __future__ import annotations

import errno
import math
import os
import random
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from drivers.errors import DeviceFault, Refused
from drivers.guarded import GuardedSource
from drivers.interlock import Interlock
from drivers.protocols import ReadingFlag
from drivers.safety import CurrentLimits
from estimator.acquisition.acquire import MOST_REFUSED, Choice, Progress, acquire, references_of
from estimator.acquisition.averages import is_settled
from estimator.acquisition.pace import FEWEST_READINGS, Pace, digest_of, stops_of
from estimator.errors import InvalidInput
from estimator.readings.observations import Observations
from estimator.readings.plan import load_plan
from estimator.rig.rig import Rig
from estimator.store.growing import StopReadings, load_so_far, new_header, observations_of
from estimator.store.journal import Journal, read_journal
from estimator.store.session import load_session, seal
from tests.drivers.memory import HOME, MemoryArm, MemorySensor, MemorySource

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


@pytest.fixture
def stops(small_rig: Rig, tmp_path: Path) -> Observations:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return stops_of(load_plan(path, small_rig), small_rig, seed=0)


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


@pytest.fixture
def run(tmp_path: Path, small_rig: Rig, stops: Observations) -> Run:
    return Run(tmp_path / "session.zarr", small_rig, stops)


def test_a_plan_is_visited_and_nothing_is_sent_twice(run: Run) -> None:
    told: list[Progress] = []

    def on_stop(progress: Progress) -> None:
        assert len(read_journal(run.folder)[1]) == progress.n_done  # on disk before it is reported
        told.append(progress)

    run.measure(on_stop)
    seal(run.folder)
    x_m, y_m, z_m = HOME.position_m
    targets = [(x_m + 0.01, y_m, z_m), (x_m + 0.01, y_m - 0.02, z_m), (x_m, y_m, z_m)]
    moves = [command[1] for command in run.devices.arms["arm1"].told]
    assert moves == [pytest.approx(target) for target in targets]
    assert run.devices.sources["coil1"].told == [("set", 3.0), ("set", -3.0), ("off",)]
    readings = run.readings
    assert readings.current_A.flatten().tolist() == [3.0, -3.0, -3.0]
    assert torch.allclose(readings.motion["arm1"], run.stops.motion["arm1"], atol=1e-12)
    assert bool((readings.time_s.diff() > 0.0).all())
    assert [(p.n_done, p.n_stops) for p in told] == [(1, 3), (2, 3), (3, 3)]
    assert told[-1].left_s == 0.0 < told[0].left_s


def test_stops_follow_each_other_in_the_journal_and_the_supply_is_dated_within_its_stop(run: Run) -> None:
    run.measure(stops=run.stops.rows(torch.tensor([0, 1])))
    first, second, third = run.measure()
    assert 0.0 <= first["begin_s"] < first["end_s"] == second["begin_s"] < second["end_s"] < third["begin_s"]
    for entry in (first, second, third):
        assert entry["begin_s"] < entry["time_s"] < entry["measured_s"]["coil1"] < entry["end_s"]
    intervals = load_so_far(read_journal(run.folder)[1], ["coil1"], third["end_s"])["coil1"]
    assert sum(duration_s for duration_s, _ in intervals) == pytest.approx(third["end_s"])


@pytest.mark.parametrize("error", [DeviceFault("sensor is gone"), KeyboardInterrupt(), SystemExit(143)])
def test_after_any_end_the_current_is_off_and_the_next_run_continues(run: Run, error: BaseException) -> None:

    def fail(progress: Progress) -> None:
        if progress.n_done == 2:
            raise error

    with pytest.raises(type(error)):
        run.measure(fail)
    assert run.devices.sources["coil1"].current_A == 0.0
    assert run.devices.sources["coil1"].told[-1] == ("off",)
    pose = run.devices.arms["arm1"].pose
    run.devices = rig_of_devices()
    run.devices.arms["arm1"].pose = pose  # it was left at its last pose
    run.measure()
    readings = run.readings
    assert torch.allclose(readings.motion["arm1"], run.stops.motion["arm1"], atol=1e-12)
    assert bool((readings.time_s.diff() > 0.0).all())
    assert run.devices.sources["coil1"].told == [("set", -3.0), ("off",)]


def test_a_full_disk_ends_the_run_without_current_and_without_a_stop_that_is_not_on_it(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    def fill_disk(progress: Progress) -> None:
        assert progress.n_done == 1  # the second stop is not reported
        monkeypatch.setattr(os, "pwrite", full)

    with pytest.raises(InvalidInput, match="No space left on device"):
        run.measure(fill_disk)
    monkeypatch.undo()
    assert run.devices.sources["coil1"].told[-1] == ("off",)
    assert len(run.readings) == 1


@pytest.mark.parametrize("value", [9.91e37, -9.9e37, 1e300, math.inf, math.nan])
def test_a_number_that_stands_for_none_is_not_measured_and_the_session_opens_again(
    run: Run, value: float
) -> None:
    run.devices = rig_of_devices(Scripted((1e-3, value, 2e-3)))
    answer = SimpleNamespace(value=value)
    run.devices.thermometers = {"coil1": SimpleNamespace(read_temperature_K=lambda *, timeout_s: answer)}
    run.measure()
    sealed = seal(run.folder)
    readings = run.readings
    assert load_session(run.folder).hash == sealed.hash
    assert readings.is_measured.tolist() == [[True, False, True]] * len(run.stops)
    assert bool(readings.temperature_C["coil1"].isnan().all())


@pytest.mark.parametrize("value", [1.1e12, -1e300, math.inf])
@pytest.mark.parametrize("part", ["supply", "arm"])
def test_a_current_or_pose_that_no_session_may_hold_ends_the_run_without_current(
    run: Run, value: float, part: str
) -> None:

    def spoil(_: Progress) -> None:
        if part == "supply":
            run.devices.sources["coil1"].share = value
        else:
            run.devices.arms["arm1"].pose = replace(HOME, position_m=(value, 0.0, 0.0))
            run.devices.arms["arm1"].move_to = lambda *_, **__: None

    with pytest.raises(
        (InvalidInput, DeviceFault), match="gives no new measurement|must hold numbers between"
    ):
        run.measure(spoil)
    assert run.devices.sources["coil1"].told[-1] == ("off",)
    assert len(run.readings) == 1


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_times_increase_even_if_the_clock_of_the_computer_is_set(
    run: Run, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    run.measure(stops=run.stops.rows(torch.tensor([0, 1])))
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() + step_s)
    run.measure()
    time_s = run.readings.time_s
    assert bool((time_s.diff() > 0.0).all())


def test_a_supply_that_does_not_go_off_is_told_of_but_hides_no_other_error(
    run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    class Stuck(MemorySource):
        def output_off(self, *, timeout_s: float) -> None:
            raise DeviceFault("stuck")

    run.devices.sources["coil1"] = Stuck()
    with pytest.raises(DeviceFault, match="stuck"):
        run.measure()
    run.folder, run.devices.sensors["hall"].fault = run.folder.with_name("other.zarr"), "dead"
    with pytest.raises(DeviceFault, match="dead"):
        run.measure()
    assert caplog.text.count("coil1 is not known to be off: stuck") == 2


class Tripping(MemorySource):
    """Reports a fault at the second stop, which has the same current."""

    n_read = 0
    wrong: Any = (3.0, ReadingFlag.NONE)

    def read_current_A(self, *, timeout_s: float) -> Any:
        self.n_read += 1
        return (
            self.counter.reading(*self.wrong)
            if self.n_read > 1
            else super().read_current_A(timeout_s=timeout_s)
        )


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ((2.1, ReadingFlag.OVER_RANGE), "must carry 3 A; its supply has reached a limit and measures 2.1 A"),
        ((3.0, ReadingFlag.STALE), "must carry 3 A; its supply gives no new measurement"),
        ((math.nan, ReadingFlag.NONE), "must carry 3 A; its supply gives no new measurement"),
    ],
)
def test_a_stop_whose_current_is_not_confirmed_is_not_recorded(run: Run, wrong: Any, words: str) -> None:
    run.devices.sources["coil1"] = Tripping()
    run.devices.sources["coil1"].wrong = wrong
    run.stops = run.stops.rows(torch.tensor([0, 0]))
    with pytest.raises(DeviceFault, match=words):
        run.measure()
    assert run.devices.sources["coil1"].told == [("set", 3.0), ("off",)]
    assert len(run.readings) == 1


def test_every_supply_is_read_at_every_stop_even_if_its_current_stays(run: Run) -> None:
    class Tripped(Tripping):
        """Behaves like a guarded supply that has switched itself off."""

        def read_current_A(self, *, timeout_s: float) -> Any:
            if self.n_read:
                raise DeviceFault("coil1 must carry 3 A; it measures 0 A")
            return super().read_current_A(timeout_s=timeout_s)

    run.devices.sources["coil1"] = Tripped()
    run.stops = run.stops.rows(torch.tensor([0, 0]))
    with pytest.raises(DeviceFault, match="measures 0 A"):
        run.measure()
    assert len(run.readings) == 1


def test_the_current_that_was_measured_is_part_of_the_session(run: Run) -> None:
    run.devices.sources["coil1"].share = 0.999
    run.measure()
    seal(run.folder)
    readings = run.readings
    assert readings.current_measured_A is not None
    assert readings.current_measured_A.flatten().tolist() == pytest.approx([2.997, -2.997, -2.997])
    assert readings.current_A.flatten().tolist() == [3.0, -3.0, -3.0]


def test_temperatures_are_recorded_with_every_reading(run: Run) -> None:
    class Warming:
        """Reads a kelvin more each time; the second reading has no number."""

        n_read = 0

        def read_temperature_K(self, *, timeout_s: float) -> Any:
            self.n_read += 1
            value_K = math.nan if self.n_read == 2 else 293.15 + self.n_read
            return MemorySensor().counter.reading(value_K)

    run.devices.thermometers["coil1"] = Warming()
    run.measure()
    growing = run.readings
    seal(run.folder)
    for readings in (growing, run.readings):
        assert list(readings.temperature_C) == ["coil1"]
        assert readings.temperature_C["coil1"].tolist() == pytest.approx([21.0, math.nan, 23.0], nan_ok=True)


def test_a_thermometer_added_while_a_session_is_interrupted_has_no_earlier_readings(small_rig: Rig) -> None:
    entries = [
        StopReadings(float(i), [1.0], {"arm1": [0.0] * 6}, {"hall": [0.0] * 3}, False, 0).entry()
        for i in range(2)
    ]
    del entries[0]["temperature_C"]  # as in journals of earlier versions
    entries[1]["temperature_C"] = {"coil1": 25.0}
    temperature_C = observations_of(entries, small_rig).temperature_C["coil1"]
    assert temperature_C.tolist() == pytest.approx([math.nan, 25.0], nan_ok=True)


def test_readings_are_averaged_without_those_that_repeat(run: Run) -> None:
    values = [
        (0.0, 0.0, 1e-3),
        (0.0, 0.0, 3e-3),
        ((9.0, 9.0, 9.0), ReadingFlag.STALE),
        *[(0.0, 0.0, 1e-3), (0.0, 0.0, 3e-3)] * 2,
    ]
    entry = run.first_entry(Scripted(*values))
    assert entry["field_T"]["hall"] == pytest.approx([0.0, 0.0, 2e-3])
    assert entry["sd_T"]["hall"][2] == pytest.approx(1e-3 * math.sqrt(6 / 5))
    assert entry["is_settled"]


def test_a_stop_is_dated_by_the_clock_of_its_instrument(run: Run) -> None:
    class Late(MemorySensor):
        """Delivers its readings 20 ms after it took them, but the first at once; its clock counts from 1970."""

        n_read = 0

        def read_field_T(self, *, timeout_s: float) -> Any:
            self.n_read += 1
            now_s = time.monotonic()
            taken_s = now_s if self.n_read == 1 else now_s - 0.02
            return self.counter.reading((0.0, 0.0, 1e-3), host_monotonic_s=now_s, device_time_s=taken_s + 1e9)

    entry = run.first_entry(Late(), n_readings=10)
    assert entry["delay_s"]["hall"] == pytest.approx(0.018, abs=1e-3)
    again = replace(run, folder=run.folder.with_name("again")).first_entry(MemorySensor())
    assert again["delay_s"] == {}  # neither the sensor nor the arm has a clock


def test_how_old_a_reading_may_be_is_in_the_journal(run: Run) -> None:
    class Slow(MemorySensor):
        def read_field_T(self, *, timeout_s: float) -> Any:
            time.sleep(0.05)
            return super().read_field_T(timeout_s=timeout_s)

    entry = run.first_entry(Slow())
    assert sorted(entry["answer_s"]) == ["arm1", "coil1", "hall"]
    assert entry["answer_s"]["hall"] >= 0.05
    assert 0.0 < entry["answer_s"]["coil1"] < entry["end_s"] - entry["begin_s"]


@pytest.mark.parametrize("step_s", [-1.5, -0.5, 0.5, 1.5])
def test_times_increase_even_if_the_clock_of_an_instrument_is_set(run: Run, step_s: float) -> None:
    class Set(MemorySensor):
        """Its clock is set before the second stop."""

        step_s = 0.0

        def read_field_T(self, *, timeout_s: float) -> Any:
            now_s = time.monotonic()
            return self.counter.reading(
                (0.0, 0.0, 1e-3), host_monotonic_s=now_s, device_time_s=now_s + self.step_s
            )

    run.devices = rig_of_devices(Set())

    def set_clock(_: Progress) -> None:
        run.devices.sensors["hall"].step_s = step_s

    begin_s = time.monotonic()
    times_s = [entry["time_s"] for entry in run.measure(set_clock)]
    assert times_s == sorted(times_s)
    assert 0.0 < times_s[-1] < time.monotonic() - begin_s


@pytest.mark.parametrize(("step_m", "is_same"), [(3e-6, True), (1e-4, False)])
def test_an_arm_that_stands_still_keeps_its_pose_unless_it_was_bumped(
    run: Run, step_m: float, is_same: bool
) -> None:
    class Trembling(MemoryArm):
        n_read = 0

        def read_pose(self, *, timeout_s: float) -> Any:
            self.n_read += 1
            x_m, y_m, z_m = self.pose.position_m
            return self.counter.reading(replace(self.pose, position_m=(x_m + step_m * self.n_read, y_m, z_m)))

    run.devices.arms["arm1"] = Trembling()
    first, second, third = (entry["motion"]["arm1"] for entry in run.measure())
    assert (first == second) is is_same
    assert second != third


def test_a_field_that_settles_late_is_waited_for(run: Run) -> None:
    falling = [(0.0, 0.0, 1e-3 * 2.0**-i) for i in range(20)]
    entry = run.first_entry(Scripted(*falling, (0.0, 0.0, 0.0)), 12)
    assert entry["is_settled"]
    assert entry["field_T"]["hall"][2] < 1e-8


def test_a_field_that_never_settles_is_marked(run: Run) -> None:
    rising = [(0.0, 0.0, 1e-6 * i) for i in range(200000)]
    assert not run.first_entry(Scripted(*rising), 12)["is_settled"]


@pytest.mark.parametrize("n_readings", [FEWEST_READINGS, FEWEST_READINGS + 1, 10, 50])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_field_that_changes_steadily_has_not_settled_for_any_number_of_readings(
    run: Run, n_readings: int, noise: float
) -> None:
    draw = random.Random(3)
    rising = [(0.0, 0.0, 1e-6 * (i + draw.gauss(0.0, noise))) for i in range(100_000)]
    entry = run.first_entry(Scripted(*rising), n_readings)
    assert not entry["is_settled"]


def test_noise_alone_is_taken_for_a_change_at_few_stops() -> None:
    draw = torch.Generator().manual_seed(5)
    field_T = torch.randn(2000, FEWEST_READINGS, 3, generator=draw, dtype=torch.float64)
    n_changing = sum(not is_settled(readings_T) for readings_T in field_T)
    assert n_changing < 0.03 * len(field_T)


def test_what_left_the_range_is_not_measured(run: Run) -> None:
    over = ((math.nan, 1e-3, 2e-3), ReadingFlag.OVER_RANGE)
    entry = run.first_entry(Scripted(over))
    assert entry["field_T"]["hall"] == [None, pytest.approx(1e-3), pytest.approx(2e-3)]


def test_what_an_instrument_lost_is_counted_in_the_journal(run: Run) -> None:
    good = (0.0, 0.0, 1e-3)
    lossy = [good, good, (good, ReadingFlag.DROPPED), (good, ReadingFlag.DROPPED | ReadingFlag.STALE), good]
    entry = run.first_entry(Scripted(*lossy))
    assert entry["n_gaps"] == {"hall": 2}
    again = replace(run, folder=run.folder.with_name("again")).first_entry(
        Scripted((good, ReadingFlag.DROPPED), good)
    )
    assert again["n_gaps"] == {"hall": 0}  # losses before the first reading do not count


def test_an_overload_without_a_component_takes_all_three(run: Run) -> None:
    entry = run.first_entry(Scripted(((1e-3, 1e-3, 2e-3), ReadingFlag.OVER_RANGE)))
    assert entry["field_T"]["hall"] == [None, None, None]


def test_a_supply_that_tripped_by_itself_is_seen_at_the_next_stop_though_its_current_stays(run: Run) -> None:
    supply, interlock = MemorySource(), Interlock()
    limits = CurrentLimits(-5.0, 5.0, 10.0, continuous_A=5.0, thermal_time_constant_s=100.0)
    run.devices.sources["coil1"] = GuardedSource(supply, limits, interlock, name="coil1", tolerance_A=0.01)

    def trip(_: Progress) -> None:
        supply.current_A = 0.0

    run.stops = run.stops.rows(torch.tensor([0, 0]))
    with pytest.raises(DeviceFault, match="delivers 0 A where 3 A were set"):
        run.measure(trip)
    assert len(run.readings) == 1


class Narrow(MemoryArm):
    """Refuses the places of the first two stops."""

    def move_to(self, base_from_flange: Any, *, speed_m_per_s: float, timeout_s: float) -> None:
        x_m, y_m, _ = base_from_flange.position_m
        if x_m > HOME.position_m[0] + 0.005 and y_m > HOME.position_m[1] - 0.01:
            raise Refused("arm.joint_2_rad must be within -7 and 0.03")
        super().move_to(base_from_flange, speed_m_per_s=speed_m_per_s, timeout_s=timeout_s)


def test_a_chosen_stop_that_is_refused_is_told_and_another_one_chosen(run: Run) -> None:
    told, asked = list[Refused](), list[tuple[int, list[int]]]()
    run.devices.arms["arm1"] = Narrow()

    def choose(entries: Sequence[Mapping[str, Any]], refused: Sequence[int]) -> Choice | None:
        asked.append((len(entries), list(refused)))
        if len(entries) == 2:
            return None
        return Choice(2 if refused else 0, False, 0, 1.0, 1.0, {})

    assert len(run.measure(choose=choose, on_refused=told.append)) == 2
    assert asked == [(0, []), (0, [0]), (1, []), (1, [0]), (2, [])]
    assert [str(refusal) for refusal in told] == ["arm.joint_2_rad must be within -7 and 0.03"] * 2
    assert run.devices.sources["coil1"].told[-1] == ("off",)


def test_a_stop_of_a_plan_that_is_refused_ends_the_run_and_so_do_many_chosen_ones(run: Run) -> None:
    n_asked = 0
    run.devices.arms["arm1"] = Narrow()

    def choose(entries: Sequence[Mapping[str, Any]], refused: Sequence[int]) -> Choice:  # noqa: ARG001
        nonlocal n_asked
        n_asked += 1
        return Choice(0, False, 0, 1.0, 1.0, {})

    for name, chooser in (("plan", None), ("chosen", choose)):
        run.folder = run.folder.with_name(f"{name}.zarr")
        with pytest.raises(Refused, match="must be within"):
            run.measure(choose=chooser)
        assert not read_journal(run.folder)[1]
        assert run.devices.sources["coil1"].told[-1] == ("off",)
    assert n_asked == MOST_REFUSED

"""Stops are visited in order, each is on disk before it is reported, and no current flows after a run, even one that failed."""

from __future__ import annotations

import errno
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch

from drivers.errors import BroughtToRest, DeviceFault, Refused
from drivers.protocols import ReadingFlag
from estimator.acquisition.acquire import MOST_REFUSED, Choice, Progress
from estimator.errors import InvalidInput
from estimator.store.growing import load_so_far
from estimator.store.journal import read_journal
from estimator.store.session import seal
from tests.drivers.memory import HOME, MemoryArm, MemorySource
from tests.estimator.acquisition.measured import rig_of_devices


def test_a_plan_is_visited_and_nothing_is_sent_twice(run):
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


def test_stops_follow_each_other_in_the_journal_and_the_supply_is_dated_within_its_stop(run):
    run.measure(stops=run.stops.rows(torch.tensor([0, 1])))
    first, second, third = run.measure()
    assert 0.0 <= first["begin_s"] < first["end_s"] == second["begin_s"] < second["end_s"] < third["begin_s"]
    for entry in (first, second, third):
        assert entry["begin_s"] < entry["time_s"] < entry["measured_s"]["coil1"] < entry["end_s"]
    intervals = load_so_far(read_journal(run.folder)[1], ["coil1"], third["end_s"])["coil1"]
    assert sum(duration_s for duration_s, _ in intervals) == pytest.approx(third["end_s"])


@pytest.mark.parametrize("error", [DeviceFault("sensor is gone"), KeyboardInterrupt(), SystemExit(143)])
def test_after_any_end_the_current_is_off_and_the_next_run_continues(run, error):

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


def test_a_full_disk_ends_the_run_without_current_and_without_a_stop_that_is_not_on_it(run, monkeypatch):

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


@pytest.mark.parametrize("value", [1.1e12, -1e300, math.inf])
@pytest.mark.parametrize("part", ["supply", "arm"])
def test_a_current_or_pose_that_no_session_may_hold_ends_the_run_without_current(run, value, part):

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
def test_times_increase_even_if_the_clock_of_the_computer_is_set(run, monkeypatch, step_s):
    run.measure(stops=run.stops.rows(torch.tensor([0, 1])))
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() + step_s)
    run.measure()
    time_s = run.readings.time_s
    assert bool((time_s.diff() > 0.0).all())


def test_a_supply_that_does_not_go_off_is_told_of_but_hides_no_other_error(run, caplog):
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
def test_a_stop_whose_current_is_not_confirmed_is_not_recorded(run, wrong, words):
    run.devices.sources["coil1"] = Tripping()
    run.devices.sources["coil1"].wrong = wrong
    run.stops = run.stops.rows(torch.tensor([0, 0]))
    with pytest.raises(DeviceFault, match=words):
        run.measure()
    assert run.devices.sources["coil1"].told == [("set", 3.0), ("off",)]
    assert len(run.readings) == 1


def test_the_current_that_was_measured_is_part_of_the_session(run):
    run.devices.sources["coil1"].share = 0.999
    run.measure()
    seal(run.folder)
    readings = run.readings
    assert readings.current_measured_A is not None
    assert readings.current_measured_A.flatten().tolist() == pytest.approx([2.997, -2.997, -2.997])
    assert readings.current_A.flatten().tolist() == [3.0, -3.0, -3.0]


class Narrow(MemoryArm):
    """Refuses the places of the first two stops."""

    def move_to(self, base_from_flange: Any, *, speed_m_per_s: float, timeout_s: float) -> None:
        x_m, y_m, _ = base_from_flange.position_m
        if x_m > HOME.position_m[0] + 0.005 and y_m > HOME.position_m[1] - 0.01:
            raise Refused("arm.joint_2_rad must be within -7 and 0.03")
        super().move_to(base_from_flange, speed_m_per_s=speed_m_per_s, timeout_s=timeout_s)


def test_a_chosen_stop_that_is_refused_is_told_and_another_one_chosen(run):
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


def test_a_stop_of_a_plan_that_is_refused_ends_the_run_and_so_do_many_chosen_ones(run):
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


class Tripped(MemoryArm):
    """Belongs to a rig that its watch has brought to rest."""

    def move_to(self, base_from_flange: Any, *, speed_m_per_s: float, timeout_s: float) -> None:
        raise BroughtToRest("the rig must be opened anew before it can continue")


def test_a_rig_that_was_brought_to_rest_refuses_no_single_stop(run):
    told, asked = list[Refused](), list[int]()
    run.devices.arms["arm1"] = Tripped()

    def choose(entries: Sequence[Mapping[str, Any]], refused: Sequence[int]) -> Choice:  # noqa: ARG001
        asked.append(len(entries))
        return Choice(0, False, 0, 1.0, 1.0, {})

    with pytest.raises(BroughtToRest):
        run.measure(choose=choose, on_refused=told.append)
    assert asked == [0]
    assert not told

"""`coilcal live`: follows a session while it grows, says what it knows, and leaves the measurement alone."""

from __future__ import annotations

import io
import json
import math
import re
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from rich.console import Console

from estimator.cli import live_session
from estimator.cli.live_view import LiveState, screen
from estimator.live import engine, refresh
from estimator.live.refresh import Background, Refreshed
from estimator.live.stream import Stream
from estimator.live.watch import Alarm
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.rig import Cause, Rig
from estimator.store.growing import StopReadings, new_header
from estimator.store.journal import Journal
from estimator.store.session import Session, seal
from tests.estimator.cli.conftest import run

N_STOPS = 108


def records(readings: Observations, from_row: int, gain: float) -> list[StopReadings]:
    """Stops that a measurement would write; from some row on, the field is weaker."""
    stops = []
    for row in range(len(readings)):
        field_T = readings.field_sensor_T[row] * (gain if row >= from_row else 1.0)
        motion = {"arm1": readings.motion["arm1"][row].tolist()}
        set_to = (float(row), readings.current_A[row].tolist(), motion)
        shown = ({"coil1": 2.998}, {"hall": [1e-6, 2e-6, 3e-6]})
        stops.append(StopReadings(*set_to, {"hall": field_T.tolist()}, False, 0, *shown))
    return stops


@pytest.fixture
def stops(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float]) -> list[StopReadings]:
    readings = simulate(small_rig, replace(small_plan, repeats=4), small_truth, seed=4).calibration
    return records(readings, 80, 0.97)


def write(path: Path, rig: Rig, stops: Sequence[StopReadings], pause_s: float = 0.0) -> None:
    """The journal of a measurement."""
    with Journal.create(path, new_header(rig, "a test", "plan", {}, N_STOPS)) as journal:
        for stop in stops:
            journal.append(stop.entry())
            time.sleep(pause_s)


def written_in_a_thread(path: Path, rig: Rig, stops: Sequence[StopReadings]) -> threading.Thread:
    """A session that begins late, grows, and ends."""

    def grow() -> None:
        time.sleep(0.3)
        write(path, rig, stops, 0.02)
        seal(path)

    writer = threading.Thread(target=grow)
    writer.start()
    return writer


@pytest.fixture
def growing(tmp_path: Path, small_rig: Rig, stops: list[StopReadings]) -> Iterator[Path]:
    path = tmp_path / "session.zarr"
    writer = written_in_a_thread(path, small_rig, stops)
    yield path
    writer.join()


def test_it_follows_a_session_to_its_end_and_dates_what_changed(growing):
    result = run("live", growing, "--no-refresh", "--json", "--wait", "20")
    assert result.exit_code == 0, result.stderr
    said = json.loads(result.stdout)
    assert (said["stops"], said["readings"], said["refreshed"]) == (N_STOPS, N_STOPS, None)
    assert said["is_polished"]
    assert said["parameters"]["coil1.radius_m"]["low"] < 0.0518
    assert said["alarms"][0]["since"] == pytest.approx(81, abs=6)
    assert f"alarm: {said['alarms'][0]['words']}" in result.stderr
    assert f"of {N_STOPS}, estimate after " in result.stderr


def test_what_is_not_fitted_and_what_was_lost_is_said(tmp_path, small_rig, stops):
    path = tmp_path / "session.zarr"
    stops[3] = replace(stops[3], is_validation=True)
    stops[4] = replace(stops[4], field_T={"hall": [math.nan] * 3})
    stops[5] = replace(stops[5], n_gaps={"hall": 2})
    write(path, small_rig, stops[:9])
    seal(path)
    said = json.loads(run("live", path, "--no-refresh", "--json").stdout)
    assert (said["stops"], said["readings"], said["skipped"], said["gaps"]) == (9, 7, 2, 2)
    text = run("live", path, "--no-refresh").stdout
    assert "; 2 readings not fitted (validation, or no field)" in text
    assert "; READINGS LOST BY AN INSTRUMENT 2 times" in text
    assert "estimate polished: the same as a fit of all readings so far" in text


def test_a_session_that_was_measured_before_has_alarms_too(tmp_path, small_rig, stops):
    """Its readings are taken in growing parts, each of which is compared with its prediction by those before."""
    path = tmp_path / "session.zarr"
    write(path, small_rig, stops)
    seal(path)
    said = json.loads(run("live", path, "--no-refresh", "--json").stdout)
    assert said["readings"] == N_STOPS
    assert said["alarms"][0]["since"] == pytest.approx(81, abs=6)


@pytest.mark.slow
def test_a_current_that_begins_to_drift_in_mid_session_is_named_and_dated(
    tmp_path, small_rig, small_plan, small_truth
):
    """The coil is cold for half the session, then warms up by 12 K, and its current sags by 0.4 % per kelvin."""
    path = tmp_path / "session.zarr"
    begin, order = N_STOPS // 2, torch.randperm(N_STOPS, generator=torch.Generator().manual_seed(1))
    readings = simulate(small_rig, replace(small_plan, repeats=4), small_truth, seed=4).calibration.alone
    warming_K = [12.0 * max(0.0, row - begin) / (N_STOPS - begin) for row in range(N_STOPS)]
    warm = [
        replace(
            one,
            time_s=float(row),
            field_T={"hall": [(1.0 - 0.004 * warming_K[row]) * b for b in one.field_T["hall"]]},
            temperature_C={"coil1": 22.0 + warming_K[row]},
        )
        for row, one in enumerate(records(readings.rows(order).alone, N_STOPS, 1.0))
    ]
    writer = written_in_a_thread(path, small_rig, warm)
    result = run("live", path, "--json", "--wait", "60")
    writer.join()
    assert result.exit_code == 0, result.stderr
    said = json.loads(result.stdout)
    assert (said["readings"], said["trouble"]) == (N_STOPS, None)
    assert said["refreshed"]["n_readings"] == N_STOPS
    found = said["refreshed"]["verdict"]
    named = {
        "named": "coil_heating[coil1]",
        "indistinguishable": "coil_heating[coil1] or something not in the library",
    }[found]
    assert said["refreshed"]["causes"] == [named]
    assert said["refreshed"]["places"] == ["coil1"]
    since = said["since"]
    assert begin <= since < begin + 20
    verdict = (
        f"diagnosis: {found}: {named} (after {N_STOPS} readings); residuals are off since reading {since}"
    )
    assert verdict in result.stderr
    low, high = said["refreshed"]["ci90"]["coil1.radius_m"]
    assert low < high


def empty_state(rig: Rig) -> LiveState:
    return LiveState("session.zarr", rig.movers, 0, (), 0, 0.0, None, (), None, False)


def shown(state: LiveState) -> str:
    console = Console(width=220, record=True, file=io.StringIO())
    console.print(screen(state))
    return console.export_text()


class Failing(Background):
    """A background whose process is killed at every attempt."""

    def __init__(self, seed: int) -> None:
        self.seen: list[int] = []
        self._is_busy = False
        self.trouble: str | None = None

    def __exit__(self, *_: object) -> None:
        pass

    def wants(self, n_readings: int) -> bool:
        return n_readings >= 50 and not self.seen

    def offer(self, session: Session) -> None:
        self.seen.append(len(session.observations))
        self.trouble = "it was killed"

    def take(self) -> None:
        pass

    def last(self, session: Session) -> None:
        self.trouble = f"it was killed twice, at {self.seen} and {len(session.observations)} readings"


def test_a_background_that_fails_is_said_and_leaves_estimate_and_alarms_as_they_are(growing, monkeypatch):
    monkeypatch.setattr(refresh, "Background", Failing)
    result = run("live", growing, "--json", "--wait", "20")
    assert result.exit_code == 0, result.stderr
    said = json.loads(result.stdout)
    found = re.fullmatch(r"it was killed twice, at \[(\d+)\] and (\d+) readings", said["trouble"])
    assert found is not None
    assert 50 <= int(found[1]) < int(found[2]) == N_STOPS
    assert (said["readings"], said["refreshed"]) == (N_STOPS, None)
    assert said["alarms"]
    assert result.stderr.count("coilcal: it was killed") == 2


class Telling(Failing):
    """A background that has a posterior at every look."""

    def __init__(self, best: dict[str, float]) -> None:
        super().__init__(0)
        self.best = best

    def take(self) -> Refreshed:
        return Refreshed(9, self.best, {}, "nothing_found", (), 1.0)

    def wants(self, n_readings: int) -> bool:
        return False


def test_an_estimate_that_a_diagnosis_has_moved_is_not_called_polished(
    tmp_path, small_rig, small_truth, stops
):
    path = tmp_path / "session.zarr"
    write(path, small_rig, stops[:9])
    session = live_session.LiveSession(path)
    session.step(None)
    deadline_s = time.monotonic() + 60.0
    while "same as a fit" not in session.state(None).standing and time.monotonic() < deadline_s:
        session.step(None)
    assert session.state(None).standing.startswith("polished")
    session.step(Telling(small_rig.nominal_values() | small_truth))
    assert session.state(None).standing.startswith("not polished yet")


def test_nothing_is_made_of_the_readings_while_none_is_new(tmp_path, small_rig, stops, monkeypatch):
    path = tmp_path / "session.zarr"
    write(path, small_rig, stops[:5])
    calls = []
    real = engine.observations_of
    monkeypatch.setattr(engine, "observations_of", lambda *given: calls.append(1) or real(*given))
    monkeypatch.setattr(refresh, "Background", Failing)
    ending = threading.Timer(1.0, seal, [path])
    ending.start()
    result = run("live", path)
    ending.join()
    assert result.exit_code == 0
    assert len(calls) == 2  # for the five, and for the end


@pytest.mark.parametrize(
    ("places", "since"), [(("probe2",), 40), (("probe1",), 21), (("coil1",), 21), ((), 21)]
)
def test_what_is_named_in_a_sensor_is_dated_by_the_readings_of_that_sensor(small_rig, places, since):
    alarms = (
        Alarm("probe1", "x", 21, 27, 2.0),
        Alarm("probe2", "y", 40, 45, 2.0),
        Alarm("probe2", "x, y and z together", 5, 5, 9.0),
    )
    known = Refreshed(60, {}, {}, "named", ("a cause",), 1.0, places)
    state = replace(empty_state(small_rig), alarms=alarms, refreshed=known)
    assert state.since == since
    assert state.verdict.endswith(f"; residuals are off since reading {since}")


def test_the_screen_shows_instruments_intervals_alarms_and_verdict(small_rig, small_plan, small_truth, stops):
    empty = empty_state(small_rig)
    assert "stop 0" in shown(empty)
    assert "diagnosis: not yet" in shown(empty)
    stream = Stream(small_rig)
    readings = simulate(small_rig, small_plan, small_truth, seed=4).calibration
    estimate = replace(stream.update(readings), took_s=0.012)
    polished = replace(empty, estimate=replace(estimate, is_polished=True))
    assert "polished: the same as a fit of all readings so far" in shown(polished)
    without = replace(
        polished, estimate=replace(polished.estimate, missing=(Cause("background_field", "room"),))
    )
    assert (
        "it holds only where background_field[room] is absent, which these currents cannot tell"
        in without.standing
    )
    alarm = Alarm("hall", "x", 21, 27, 2.0)
    known = Refreshed(20, {}, {"coil1.radius_m": (0.0511, 0.0522)}, "named", ("coil_heating[coil1]",), 1.0)
    record = replace(
        stops[0],
        n_gaps={"hall": 1},
        field_T={"hall": [float("nan"), 1e-3, 2e-3]},
        is_settled=False,
        temperature_C={"coil1": 31.26, "hall": float("nan")},
    ).entry()
    text = shown(
        replace(
            empty,
            n_stops=108,
            entries=[record] * 27,
            n_new=3,
            silent_s=42.0,
            estimate=estimate,
            alarms=(alarm,),
            refreshed=known,
            is_refreshing=True,
            n_skipped=4,
        )
    )
    for words in (
        "stop 27 of 108, estimate after 12 ms for 3 stops at once; 4 readings not fitted (validation, or no field); READINGS LOST BY AN INSTRUMENT 27 times; NO STOP FOR 42 s",
        "over range +1.000 +2.000 mT, scatter 3.0 µT, STILL CHANGING, READINGS LOST",
        "+2.9980 A",
        "31.3 °C",
        "no number",
        " mm   ",
        "90 % of the posterior after 20",
        "51.10 to 52.20",
        "not polished yet: a fit of all readings so far may differ a little",
        "alarms: 1",
        "hall: x is off by +2.0 sigma since reading 21 (noticed at 27)",
        "diagnosis: named: coil_heating[coil1] (after 20 readings); residuals are off since reading 21 (the next is being made)",
    ):
        assert words in text

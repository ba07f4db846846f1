"""Who watches an open session is told of each estimate, of places and widths, and of its end."""

from __future__ import annotations

import asyncio
import json
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import aclosing
from itertools import pairwise

import pytest
import torch
from starlette.testclient import TestClient

from estimator.live.stream import Stream
from estimator.service.core import Core
from estimator.service.live_state import REDRAWN_AT, Device, LiveState
from estimator.service.watched import Watched
from estimator.store.made import JOURNAL
from tests.estimator.service.conftest import append, begin_session, lines_of, refusal, until, upload_rig

PATIENCE_S = 30.0


@pytest.fixture
def client(idle: Callable[..., TestClient]) -> Iterator[TestClient]:
    made = idle(most_watched=2)
    yield made
    watching = made.app.state.core.watching  # type: ignore[attr-defined]
    assert not watching._watched  # nobody left a thread behind


@pytest.fixture
def session_id(client: TestClient, rig_text: str) -> str:
    return begin_session(client, upload_rig(client, rig_text))


def core_of(client: TestClient) -> Core:
    core: Core = client.app.state.core  # type: ignore[attr-defined]
    return core


def watched(
    client: TestClient,
    session_id: str,
    acts: dict[int, Callable[[], object]],
    until: int,
    is_polished: bool | None = None,
) -> list[LiveState]:
    """States of a session up to a number of readings; at some numbers something is done first."""

    async def watch(session: Watched) -> list[LiveState]:
        told: list[LiveState] = []
        is_redrawn = False
        async with asyncio.timeout(PATIENCE_S), aclosing(session.states(lambda: False)) as states:
            async for one in states:
                told.append(one)
                if (act := acts.pop(one.n_appended, None)) is not None:
                    await asyncio.to_thread(act)
                is_redrawn |= one.is_redrawn and one.n_appended >= until
                if is_redrawn and not acts and is_polished in (None, one.is_polished):
                    break
        return told

    with core_of(client).watching.watched(session_id) as session:
        return asyncio.run(watch(session))


def test_each_batch_gives_the_estimate_of_all_readings_so_far(client, session_id, small_session, small_rig):
    n = len(small_session.observations)
    ends = [0, 12, 13, 14, n]

    def send(first: int, last: int) -> Callable[[], object]:
        return lambda: append(client, session_id, lines_of(small_session, small_rig, first, last))

    acts = {first: send(first, last) for first, last in pairwise(ends)}
    told = watched(client, session_id, acts, n)
    last = told[-1]
    stream = Stream(small_rig)
    stream.update(small_session.observations.rows(torch.arange(12)))
    estimate = stream.update(small_session.observations.rows(torch.arange(12, n)))
    assert (last.n_appended, last.n_readings) == (n, estimate.n_readings)
    assert last.n_readings < n  # some are for validation
    for name, interval in last.intervals.items():
        assert interval.value == pytest.approx(estimate.intervals[name].value, abs=0.1 * interval.sd)
        assert interval.sd == pytest.approx(estimate.intervals[name].sd, rel=0.05)
    assert [place.number for place in last.places] == list(range(1, n + 1))
    assert {place.rms_sigma < 3.0 for place in last.places} == {True}
    added = next(one for one in told if one.n_appended == 14 and not one.is_redrawn)
    assert [place.number for place in added.places] == [14]
    assert [coil.name for coil in last.coils] == ["coil1"]
    assert last.coils[0].radius_m == pytest.approx(last.intervals["coil1.radius_m"].value, rel=0.3)
    assert len({one.coils[0].origin_m for one in told if one.coils}) > 1  # it was carried
    widths = [one.sd["coil1.radius_m"] for one in last.history]
    assert len(widths) >= 4
    assert widths[-1] < 0.5 * widths[0]
    assert sum(one.is_redrawn for one in told) < len(told) * REDRAWN_AT


def test_states_say_how_often_readings_came_and_for_how_long_none_has(
    client, session_id, small_session, small_rig
):
    acts = {0: lambda: append(client, session_id, lines_of(small_session, small_rig, 0, 12))}
    told = watched(client, session_id, acts, 12)
    assert (told[0].silent_s, told[0].pace_s) == (None, None)
    assert told[-1].pace_s == 1.0
    journal = core_of(client).sessions.path(session_id) / JOURNAL
    long_ago_s = journal.stat().st_mtime - 100.0
    os.utime(journal, (long_ago_s, long_ago_s))
    later = watched(client, session_id, {}, 12)[-1]
    assert later.silent_s is not None
    assert later.silent_s >= 100.0


def test_without_new_readings_the_estimate_becomes_that_of_the_batch_fit(
    client, session_id, small_session, small_rig
):
    lines = lines_of(small_session, small_rig, 0, 20)
    told = watched(client, session_id, {0: lambda: append(client, session_id, lines)}, 20, is_polished=True)
    stream = Stream(small_rig)
    stream.update(small_session.observations.rows(torch.arange(20)))
    while stream.can_polish:
        stream.polish()
    for name, interval in told[-1].intervals.items():
        assert interval.value == pytest.approx(stream.intervals()[name].value, abs=1e-6 * interval.sd)


def test_devices_are_those_of_the_readings_with_what_they_showed_last(
    client, session_id, small_session, small_rig
):
    lines = [json.loads(line) for line in lines_of(small_session, small_rig, 0, 12).splitlines()]
    for line in lines[:9]:
        line |= {"measured_A": {"coil1": 2.5}, "temperature_C": {"coil1": 20.0 + line["sequence"]}}
    lines[8]["temperature_C"] = {"coil1": None}
    lines[-1]["field_T"] = {"hall": [1e-3, None, 2e-3]}
    body = b"".join(json.dumps(line).encode() + b"\n" for line in lines)
    told = watched(client, session_id, {0: lambda: append(client, session_id, body)}, 12)
    commanded_A = lines[8]["current_A"]["coil1"]
    assert told[0].devices == []
    assert told[-1].devices == [
        Device("sensor", "hall", [1e-3, None, 2e-3], "T", n_readings=12),
        Device("mover", "arm1", lines[-1]["motion"]["arm1"][:3], "m", n_readings=12),
        Device("supply", "coil1", [2.5], "A", commanded_A, n_readings=9, n_silent=3),
        Device("thermometer", "coil1", [None], "°C", n_readings=9, n_silent=3),
    ]


def test_who_comes_late_is_told_all_and_watchers_share_one_estimate(
    client, session_id, small_session, small_rig
):
    n = len(small_session.observations)
    append(client, session_id, lines_of(small_session, small_rig, 0, n - 2))
    watching = core_of(client).watching

    async def both(first: Watched) -> None:
        async with asyncio.timeout(PATIENCE_S), aclosing(first.states(lambda: False)) as states:
            async for one in states:
                if one.n_appended == n - 2 and one.is_redrawn:
                    last = lines_of(small_session, small_rig, n - 2)  # too few for another drawing
                    await asyncio.to_thread(append, client, session_id, last)
                if one.n_appended == n:
                    break
            with watching.watched(session_id) as second:
                assert second is first
                async with aclosing(second.states(lambda: False)) as other:
                    late = await anext(other)
        assert late.is_redrawn
        assert [place.number for place in late.places] == list(range(1, n + 1))
        sizes = [widths.n_readings for widths in late.history]
        assert len(sizes) > 2  # the readings were there before, and were taken in parts
        assert sizes == sorted(sizes)

    with watching.watched(session_id) as first:
        asyncio.run(both(first))
    until(lambda: all(thread.name != "coilcal watching" for thread in threading.enumerate()))


def test_the_stream_ends_with_the_session(client, session_id, small_session, small_rig):
    append(client, session_id, lines_of(small_session, small_rig, 0, 12))

    def close() -> None:
        until(lambda: core_of(client).watching._watched)
        client.post(f"/v1/sessions/{session_id}/close")

    closing = threading.Thread(target=close)
    closing.start()
    text = client.get(f"/v1/sessions/{session_id}/live").text
    closing.join()
    events = [part.split("\n") for part in text.split("\n\n") if "data:" in part]
    kinds = [next(line for line in part if line.startswith("event:"))[7:] for part in events]
    last = json.loads(next(line for line in events[-1] if line.startswith("data:"))[6:])
    assert kinds[-1] == "end"
    assert set(kinds[:-1]) == {"estimate"}
    assert (last["n_appended"], last["fault"], last["has_ended"]) == (12, None, True)
    assert refusal(client.get(f"/v1/sessions/{session_id}/live"), 409)["rule"] == "must be open; it is closed"


def test_watched_sessions_are_counted_and_need_free_parameters(client, session_id, rig_text):
    fixed = re.sub(r"\{prior: \{normal: \{mean: (-?\d+).*\}\}\}", r"\1", rig_text)
    none_free = begin_session(client, upload_rig(client, fixed))
    assert "free parameter" in refusal(client.get(f"/v1/sessions/{none_free}/live"), 422)["detail"]
    watching = core_of(client).watching
    others = [begin_session(client, upload_rig(client, rig_text)) for _ in range(2)]
    with watching.watched(session_id), watching.watched(others[0]):
        full = refusal(client.get(f"/v1/sessions/{others[1]}/live"), 429)
        assert full["detail"] == "watched sessions must be at most 2 at once"
    refusal(client.get(f"/v1/sessions/{'0' * 32}/live"), 404)

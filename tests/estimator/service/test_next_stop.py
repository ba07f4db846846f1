"""The next stop of an open session at a service, and by its client: that of the Python API, given the same readings."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from typing import Any

import pytest
import torch

from estimator.client import AsyncClient, Client
from estimator.planning.next_stop import next_stop
from estimator.readings.plan import plan_from_text
from estimator.service.next_stops import NextStops
from tests.estimator.conftest import PLAN
from tests.estimator.service.conftest import append, begin_session, import_csv, lines_of, refusal, upload_rig

GOAL = "field 1 % in box x_mm=-20:20 y_mm=-20:20 z_mm=-10:10"
PLACES = PLAN.replace("[{coil1: 3}]", "[{coil1: 3}, {coil1: -3}, {}]")


def readings_of(session_lines: bytes) -> list[dict[str, Any]]:
    return [json.loads(line) for line in session_lines.splitlines()]


def test_a_stop_follows_from_what_is_on_disk_and_the_goals(api, rig_text, small_session, small_rig):
    session_id = begin_session(api, upload_rig(api, rig_text))
    path, body = f"/v1/sessions/{session_id}/next", {"goals": [GOAL], "places": PLACES}
    places = plan_from_text(PLACES, small_rig)
    first = api.post(path, json=body).json()
    expected = next_stop(small_rig, places, [GOAL])
    assert (first["is_end"], first["reason"]) == (False, expected.decision.reason)
    assert (first["current_A"], first["motion"]) == (expected.current_A, expected.motion)
    append(api, session_id, lines_of(small_session, small_rig, 0, 5))
    again = [api.post(path, json=body).json() for _ in range(2)]
    assert again[0] == again[1]
    some = replace(small_session.observations, time_s=torch.arange(len(small_session.observations)).double())
    expected = next_stop(small_rig, places, [GOAL], some.rows(torch.arange(5)).alone)
    assert again[0]["motion"] == expected.motion
    assert again[0]["widths"] == pytest.approx(expected.decision.widths, rel=1e-9)
    api.app.state.core.next_stops = NextStops(
        api.app.state.core.sessions.rig, api.app.state.core.sessions.path
    )
    assert api.post(path, json=body).json() == again[0]  # after a restart, too


def test_a_session_ends_where_its_goal_is_reached(url, small_session, small_rig):
    goal = "field 20 % in box x_mm=-20:20 y_mm=-20:20 z_mm=-10:10"
    readings = readings_of(lines_of(small_session, small_rig))
    with Client(url) as client:
        session = client.begin(small_rig, "a rig that asks")
        assert session.next([goal], PLACES)["reason"].startswith("informs")
        session.append(readings)
        told = session.next([goal], PLACES, most_stops=len(readings))
    assert (told["is_end"], told["motion"]) == (True, {})
    assert told["reason"].startswith(("goal reached", f"limit of {len(readings)} stops"))

    async def awaited() -> dict[str, Any]:
        async with AsyncClient(url) as client:
            return await client.session(session.id).next([goal], PLACES, most_stops=len(readings))

    assert asyncio.run(awaited()) == told


def test_what_cannot_be_asked_is_refused(api, rig_text, readings_csv):
    rig_id = upload_rig(api, rig_text)
    path = f"/v1/sessions/{begin_session(api, rig_id)}/next"
    for goals, places, words in (
        (["field 1 % in points /etc/passwd"], PLACES, "a service reads no files"),
        (["field 0 %"], PLACES, "a goal must"),
        ([GOAL], PLACES.replace("arm1", "arm9"), "arm9"),
        ([GOAL.replace("1 %", "0.00001 %")], PLACES, "within reach"),
        ([], PLACES, "goals"),
    ):
        assert words in refusal(api.post(path, json={"goals": goals, "places": places}), 422)["detail"], words
    closed = import_csv(api, rig_id, readings_csv)["id"]
    refusal(api.post(f"/v1/sessions/{closed}/next", json={"goals": [GOAL], "places": PLACES}), 409)

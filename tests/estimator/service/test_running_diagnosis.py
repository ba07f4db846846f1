"""Watched sessions are diagnosed in turn as they grow, by one process that ends with the last watcher."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from starlette.testclient import TestClient

from estimator.live.refresh import FEWEST_READINGS, GROWTH, Refreshed
from estimator.service import running_diagnosis
from estimator.service.core import Core
from estimator.service.live_state import Seen
from estimator.service.periodic import scheduler_of
from estimator.service.watched import Watched
from estimator.store.session import Session
from tests.estimator.service.conftest import append, begin_session, lines_of, until, upload_rig


class Process:
    """Stands for `Background`: each diagnosis ends when the test says so."""

    made: list[Process]
    may_end: threading.Event

    def __init__(self, _: int) -> None:
        self.is_busy, self.is_ended, self.trouble = False, False, None
        self.sessions: list[Session] = []
        self.made.append(self)

    def begin(self, session: Session) -> None:
        self.sessions.append(session)
        self.is_busy = True

    def take(self) -> Refreshed | None:
        if not self.may_end.is_set():
            return None
        self.is_busy = False
        n = len(self.sessions[-1].observations)
        return Refreshed(n, {}, {}, "named", (f"cause {len(self.sessions)}",), 1.5)

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.is_ended = True


@pytest.fixture
def core(idle: Callable[..., TestClient], monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Core, Any, Any]]:
    Process.made, Process.may_end = [], threading.Event()
    monkeypatch.setattr(running_diagnosis, "Background", Process)
    client = idle()
    made: Core = client.app.state.core  # type: ignore[attr-defined]
    scheduler = scheduler_of({"running diagnosis": (0.02, made.watching.diagnose)})
    scheduler.start()
    yield made, client, scheduler
    if scheduler.running:
        scheduler.shutdown()
    made.watching.stop()


def verdict(session: Watched) -> Any:
    return session.state_after(Seen())[0].diagnosis


def test_sessions_take_turns_and_are_diagnosed_again_when_they_have_grown(
    core, rig_text, small_session, small_rig
):
    watching, client = core[0].watching, core[1]
    ids = [begin_session(client, upload_rig(client, rig_text)) for _ in range(2)]

    def send(session_id: str, first: int, last: int) -> None:
        assert append(client, session_id, lines_of(small_session, small_rig, first, last)).status_code == 200

    with watching.watched(ids[0]) as first, watching.watched(ids[1]) as second:
        send(ids[0], 0, FEWEST_READINGS - 1)
        until(lambda: first.state_after(Seen())[0].n_appended == FEWEST_READINGS - 1)
        assert first.waits_since_s is None
        send(ids[0], FEWEST_READINGS - 1, FEWEST_READINGS)
        until(lambda: Process.made and Process.made[0].sessions)
        send(ids[1], 0, 20)
        until(lambda: second.waits_since_s is not None)
        Process.may_end.set()
        until(lambda: verdict(first) and verdict(second))
        told = verdict(first)
        assert (told.n_readings, told.causes, told.verdict) == (FEWEST_READINGS, ["cause 1"], "named")
        assert (verdict(second).n_readings, verdict(second).causes) == (20, ["cause 2"])
        again = int(GROWTH * FEWEST_READINGS) + 1
        send(ids[0], FEWEST_READINGS, again)
        until(lambda: verdict(first).n_readings == again)
        (process,) = Process.made
        assert [session.source for session in process.sessions] == ["a test"] * 3
        assert not process.is_ended
    until(lambda: process.is_ended)


def test_a_diagnosis_that_nobody_waits_for_any_more_is_ended(core, rig_text, small_session, small_rig):
    watching, client, scheduler = core[0].watching, core[1], core[2]
    session_id = begin_session(client, upload_rig(client, rig_text))
    with watching.watched(session_id):
        append(client, session_id, lines_of(small_session, small_rig, 0, 20))
        until(lambda: Process.made and Process.made[0].is_busy)
    until(lambda: Process.made[0].is_ended)
    assert len(Process.made) == 1
    with watching.watched(session_id):
        until(lambda: len(Process.made) == 2 and Process.made[1].is_busy)
        scheduler.shutdown()
        watching.stop()  # as the service does at its end
    assert Process.made[1].is_ended

"""The background process: posterior and verdict of what there is, one session after another, never in the way."""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from estimator.live.refresh import Background, Refreshed, refreshed
from estimator.store.session import Session


def of_first(session: Session, n: int) -> Session:
    readings = session.observations.rows(torch.arange(n)).alone
    return Session(session.rig, readings, session.source)


def broken(session: Session, n: int) -> Session:
    """As a bug might leave it."""
    some = of_first(session, n)
    object.__setattr__(some, "rig", None)
    return some


def test_a_session_is_refreshed_beside_the_program_and_once(small_session):
    with Background(seed=1) as background:
        background.offer(of_first(small_session, 10))
        assert not background.is_busy  # too few
        begin_s = time.monotonic()
        background.offer(small_session)
        background.offer(small_session)
        assert background.is_busy
        assert background.take() is None
        assert time.monotonic() - begin_s < 1.0
        result = background.last(small_session)
        assert background.last(small_session) is None  # it is known already
    assert result is not None
    assert result.n_readings == 36
    assert result.verdict == "nothing_found"
    low, high = result.ci90["coil1.radius_m"]
    assert low < small_session.truth["coil1.radius_m"] < high
    assert result.best["coil1.axial_loops"] == small_session.truth["coil1.axial_loops"]


def test_leaving_it_ends_the_work_at_once(small_session):
    with Background(seed=1) as background:
        background.offer(small_session)
        begin_s = time.monotonic()
    assert time.monotonic() - begin_s < 5.0


def test_a_session_that_nobody_reads_any_more_leaves_no_file_open(small_session):
    """A page is opened and closed: the process ends before it has read what it was given."""
    with Background(seed=1) as background:
        background.begin(small_session)  # what is opened once is open
    n_open = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        with Background(seed=1) as background:
            background.begin(small_session)
    assert len(list(Path("/proc/self/fd").iterdir())) == n_open


def test_a_session_that_fills_the_pipe_holds_up_nobody(small_session):
    readings = small_session.observations.rows(torch.arange(36).repeat(2000)).alone
    begin_s = time.monotonic()
    with Background(seed=1) as background:
        background.begin(Session(small_session.rig, readings, "large"))
    assert time.monotonic() - begin_s < 5.0


def test_a_process_that_is_killed_is_told_of_and_the_next_one_goes_on(small_session):
    with Background(seed=1) as background:
        background.offer(of_first(small_session, 20))
        (process,) = multiprocessing.active_children()
        process.kill()
        deadline_s = time.monotonic() + 60.0
        while background.is_busy:
            assert background.take() is None
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert background.trouble is not None
        assert background.trouble.endswith("after 20 readings failed: the process ended with exit status -9")
        assert not background.wants(20)  # what killed it would do so again
        assert background.last(broken(small_session, 25)) is None
        assert "after 25 readings failed: AttributeError: " in background.trouble  # by another process


@pytest.mark.slow
def test_a_process_that_is_killed_while_it_waits_is_followed_by_another(small_session):
    with Background(seed=1) as background:
        (process,) = multiprocessing.active_children()
        process.kill()
        process.join()
        assert background.last(of_first(small_session, 20)) is not None


def test_an_error_of_the_diagnosis_is_a_sentence_and_the_process_goes_on(small_session):
    with Background(seed=1) as background:
        (process,) = multiprocessing.active_children()
        for n in (20, 25):
            assert background.last(broken(small_session, n)) is None
            assert background.trouble is not None
            assert f"after {n} readings failed: AttributeError: " in background.trouble
        assert process.is_alive()


@pytest.mark.parametrize(
    ("verdict", "causes", "words"),
    [
        ("nothing_found", (), "nothing found (after 30 readings)"),
        ("named", ("axis_gain[hall]",), "named: axis_gain[hall] (after 30 readings)"),
    ],
)
def test_a_verdict_is_said_in_words(verdict, causes, words):
    assert Refreshed(30, {}, {}, verdict, causes, 1.0).words == words


def test_readings_that_were_recorded_wrongly_are_told(small_session):
    readings = small_session.observations.calibration.alone
    field_T = readings.field_sensor_T.clone()
    field_T[[5, 12, 19]] *= 10.0
    wrong = replace(small_session, observations=readings.with_field(field_T))
    assert refreshed(wrong, seed=1).causes == ("3 readings recorded wrongly",)

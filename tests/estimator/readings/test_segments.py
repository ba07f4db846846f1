"""Segments are as recorded, else as pauses say, and go along with every selection of readings."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.readings.observations import Observations
from estimator.readings.segments import segments_by_pauses, segments_in_turn
from estimator.readings.split import thinned

HOUR_S = 3600.0


def session(time_s: list[float], segment: list[int] | None = None) -> Observations:
    n = len(time_s)
    return Observations.of(
        torch.zeros(n, 1).double(),
        {},
        torch.zeros(n, 3).double(),
        time_s=torch.tensor(time_s, dtype=torch.float64),
        is_validation=torch.arange(n) % 3 == 0,
        recorded_segment=None if segment is None else torch.tensor(segment),
    )


TWO_DAYS_S = [0.0, 1.0, 2.0, 3.0, 8 * HOUR_S, 8 * HOUR_S + 1.0]


@pytest.mark.parametrize(
    ("hours", "expected"),
    [
        ([0.0, 0.1, 0.2, 0.9, 1.0], [-1] * 5),  # less than an hour
        ([0.0, 0.1, 0.2, 2.3, 2.4], [0, 0, 0, 1, 1]),
        ([0.0, 1.0, 2.0, 14.0, 15.0], [-1] * 5),  # less than twenty intervals
        ([0.0, 1.0, 2.0, 33.0, 34.0], [0, 0, 0, 1, 1]),
        ([0.0, 0.0, 0.1, 0.1, 5.2, 5.2, 5.3], [0, 0, 0, 0, 1, 1, 1]),  # sensors read at once make no interval
        ([7.0, 7.0, 7.0], [-1] * 3),
        ([7.0], [-1]),
    ],
)
def test_a_pause_is_an_hour_and_twenty_intervals(hours, expected):
    assert segments_by_pauses(HOUR_S * torch.tensor(hours, dtype=torch.float64)).tolist() == expected


def test_what_is_recorded_counts_and_pauses_do_not():
    assert session(TWO_DAYS_S).segment.tolist() == [0, 0, 0, 0, 1, 1]
    assert session(TWO_DAYS_S, [4, 4, 2, 2, 2, 2]).segment.tolist() == [4, 4, 2, 2, 2, 2]


@pytest.mark.parametrize("segment", [None, [0, 0, 0, 0, 1, 1]])
def test_a_selection_keeps_the_segments_of_its_session(segment):
    whole = session(TWO_DAYS_S, segment)
    assert whole.rows(torch.tensor([5, 0])).segment.tolist() == [1, 0]
    assert whole.rows(torch.tensor([4, 5])).segment.tolist() == [1, 1]  # alone they have no pause
    assert whole.validation.segment.tolist() == [0, 0]
    assert whole.calibration.segment.tolist() == [0, 0, 1, 1]
    rows = thinned(whole, 3, seed=1)
    assert rows.segment.tolist() == (rows.time_s > HOUR_S).long().tolist()


def test_readings_out_of_order_are_divided_in_order_of_time():
    assert session([8 * HOUR_S, 1.0, 0.0, 8 * HOUR_S + 1.0, 2.0]).segment.tolist() == [1, 0, 0, 1, 0]


def test_later_readings_keep_what_is_recorded_of_either():
    first, later = session([0.0, 1.0], [5, 5]), session([2.0, 3.0])
    assert first.followed_by(later).segment.tolist() == [5, 5, -1, -1]
    assert later.followed_by(first).segment.tolist() == [-1, -1, 5, 5]
    assert session([0.0, 1.0]).followed_by(later).recorded_segment is None
    assert first.alone.segment.tolist() == [5, 5]


def test_a_session_is_divided_in_turn():
    assert segments_in_turn(torch.arange(10.0), 3).tolist() == [0, 0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert replace(session([0.0, 1.0]), recorded_segment=torch.tensor([1, 0])).segment.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("interval_s", "instants_s", "words"),
    [
        (60.0, [90.0], "90 s after the first reading"),
        (60.0, [30.0, 150.0], "30 to 150 s after the first reading"),
        (1.0, [1.5], "from reading 3 on"),
        (1.0, [0.5, 2.5], "from reading 2 to 3"),
    ],
)
def test_instants_of_a_file_without_times_are_told_by_the_numbers_of_readings(interval_s, instants_s, words):
    """Such a file is read as one reading a second."""
    readings = session([interval_s * i for i in range(5)])
    assert readings.instants_in_words([at_s / HOUR_S for at_s in instants_s]) == words

"""Silence is noticed on both sides after the time that is stated, and a pause of both sides together is none."""

from __future__ import annotations

import pytest

from drivers.pulse import BEAT_S, SILENT_S, Heart, Pulse

BEATS = round(SILENT_S / BEAT_S)


@pytest.fixture
def hearts():
    pulse = Pulse()
    return Heart(pulse, is_child=False), Heart(pulse, is_child=True)


def beat(heart, n_times):
    for _ in range(n_times):
        heart.beat()


def test_who_beats_is_not_silent(hearts):
    parent, child = hearts
    for _ in range(3 * BEATS):
        parent.beat()
        child.beat()
        assert not parent.is_silent
        assert not child.is_silent


def test_who_beats_no_more_is_silent_after_five_seconds_and_not_a_beat_before(hearts):
    for this, other in (hearts, hearts[::-1]):
        other.beat()
        beat(this, BEATS)  # the first of them still hears the other
        assert not this.is_silent
        this.beat()
        assert this.is_silent
        other.beat()
        this.beat()
        assert not this.is_silent


def test_an_answer_is_a_sign_of_life_too(hearts):
    parent, _ = hearts
    parent.hear()
    beat(parent, BEATS - 1)
    parent.hear()
    beat(parent, BEATS - 1)
    assert not parent.is_silent


def test_a_child_that_still_starts_is_not_silent_and_a_parent_that_stops_meanwhile_is(hearts):
    parent, child = hearts
    beat(parent, 3 * BEATS)
    assert not parent.is_silent
    beat(child, BEATS + 1)
    assert child.is_silent

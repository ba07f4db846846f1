"""A sensor that was knocked, beside a connector that no list holds: the one is stated, the other told, in a session of independent code."""

from __future__ import annotations

import pytest

from estimator import Diagnosis
from estimator.diagnosis.headline import headline
from estimator.diagnosis.verdict import Verdict
from estimator.effects import EFFECTS
from scripts.studies.hidden_cases import diagnosed
from tests.hidden.study import draw_case

SEED = 550001  # of `make mixed`, among those that its rules were made with


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    hidden = draw_case("mixed", SEED, EFFECTS)
    assert [flaw.cause.name for flaw in hidden.flaws] == ["sensor_bumped", "loose_connector"]
    return diagnosed(hidden, SEED)[0]


def test_what_has_a_name_is_stated_beside_what_has_none(diagnosis):
    assert diagnosis.verdict is Verdict.PARTLY_EXPLAINED
    (cause,) = diagnosis.causes
    assert cause.cause.name == "sensor_bumped"
    assert cause.probability > 0.8
    assert diagnosis.improvement is not None
    assert diagnosis.improvement.after.errors.vector_T < diagnosis.improvement.before.errors.vector_T


def test_what_is_printed_says_so_in_two_sentences(diagnosis):
    first, second, *_ = headline(diagnosis)
    assert first.startswith(EFFECTS["sensor_bumped"].words[:1].upper() + EFFECTS["sensor_bumped"].words[1:])
    assert second.startswith("What is left is best described so: ")
    assert "sensor_bumped" not in second


def test_the_file_has_each_with_its_probability_in_halves_and_its_link(diagnosis):
    mixture = diagnosis.to_json()["mixture"]
    (first,) = (entry for entry in mixture["found"] if entry["is_one_of"][0]["name"] == "sensor_bumped")
    others = [entry for entry in mixture["found"] if entry is not first]
    assert first["is_one_of"][0]["link"] == "mount"
    assert first["probability"] == first["with_all_readings"]  # halves have what is expected of them
    assert 2.0 * first["in_halves"] > first["expected_in_halves"]
    assert first["probability"] > 0.9
    assert any(not one["is_one_of"][0]["is_listed"] for one in others)
    assert sum(mixture["unlisted"].values()) > 0.5


def test_readings_taken_when_a_spell_was_over_tell_it_from_a_step():
    """What was asked ends within the spell: by that a step is as probable. A chair that was moved stands beside both."""
    seed = 563025  # of `make mixed`, among those that its rules were made with
    hidden = draw_case("mixed", seed, EFFECTS)
    assert [flaw.cause.name for flaw in hidden.flaws] == ["current_spell", "coil_misplaced", "chair_moved"]
    causes = diagnosed(hidden, seed)[0].causes
    assert {"current_spell", "coil_misplaced"} <= {named.cause.name for named in causes}
    (spell,) = (named for named in causes if named.cause.name == "current_spell")
    assert not spell.alternatives

"""The judge of printed statements catches a false one of each kind, and takes true ones for true."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimator.diagnosis.statements.moved import NO_LONGER_DETERMINED
from estimator.effects import EFFECTS
from estimator.readings.observations import Observations
from scripts.studies.judge import of_calibration, sessions
from scripts.studies.judge.case import Case
from scripts.studies.judge.handed_out import HandedOut
from scripts.studies.judge.intervals import false_intervals, missed_90
from scripts.studies.judge.sessions import KINDS, ended, hidden_case
from scripts.studies.judge.statements import Statement
from scripts.studies.judge.truth import TrueCause, Truth
from scripts.studies.truthful import judged, line, show
from tests.estimator.conftest import TRUTH
from tests.scripts.judged import (
    FLAG,
    GAIN,
    NAMED,
    ONLY_GAIN,
    OUTLIER,
    OUTSIDE,
    SMALL_GAIN,
    WITH_OUTSIDE,
    are_true,
    hidden,
    wrong_truth,
)

pytestmark = pytest.mark.whole


def test_what_is_printed_of_a_right_calibration_is_true_and_every_line_is_read(told, printed, folder):
    statements = told(printed)
    assert not [one for each in statements.values() for one in each if not one.is_true]
    assert {"good", "error", "coverage", "interval_as_drawn", "loop_counts"} <= set(statements)
    _, unread = judged(Case(folder, None))
    assert unread == []


def test_good_is_false_where_an_interval_excludes_the_truth(told, printed, small_calibration):
    assert are_true(told(printed), "good") == [
        True,
        True,
    ]  # of `calibrate`, and of the calibration beside the diagnosis
    assert are_true(told(printed, truth=wrong_truth(small_calibration)), "good") == [False, False]


def test_good_of_a_map_is_false_where_held_out_readings_are_missed(told, printed, folder, monkeypatch):
    told(printed)
    statements, _ = judged(Case(folder, None))
    assert [one.is_true for one in statements if one.kind == "good"] == [True, True]
    right = HandedOut.readings_T
    monkeypatch.setattr(HandedOut, "readings_T", lambda self, *readings: right(self, *readings) + 1e-5)
    statements, _ = judged(Case(folder, None))
    assert [one.is_true for one in statements if one.kind == "good"] == [False, False]


@pytest.mark.parametrize(
    ("kind", "was", "is_now"),
    [
        ("error", r"validation: error ", "validation: error 1"),
        ("coverage", r"intervals ", "intervals 1"),
        (
            "interval_as_drawn",
            "coil1.radius_m                         ",
            "coil1.radius_m                         9",
        ),
        ("expected_noise", "expected noise leaves ", "expected noise leaves 1"),
    ],
)
def test_a_printed_number_that_the_files_do_not_give_is_false(told, printed, kind, was, is_now):
    assert was in printed
    changed = printed.replace(was, is_now)
    if kind == "interval_as_drawn":
        lines = printed.splitlines()
        row = next(one for one in lines if one.startswith("coil1.radius_m "))
        name, median, *rest = row.split()
        changed = printed.replace(row, f"{name} {float(median) + 0.1:.6g} {'  '.join(rest[:2])}  {rest[2]}")
    assert all(are_true(told(printed), kind))
    assert not all(are_true(told(changed), kind))


def test_a_noise_by_repeats_is_what_they_scatter(told, printed, monkeypatch):
    changed = printed.replace("the expected noise leaves 8.66", "repeated readings scatter by 5.2")
    assert changed != printed
    for noise_T, is_true in ((3e-6, True), (5e-6, False)):
        monkeypatch.setattr(of_calibration, "scatter_of_sensors", lambda *_, n=noise_T: {"hall.noise_T": n})
        assert are_true(told(changed), "expected_noise") == [is_true]


def test_a_loop_count_that_is_stated_as_a_fact_is_false_where_it_is_another(told, printed, small_calibration):
    best = small_calibration.summary()["loop_counts"][0]
    assert best["probability"] > 0.99, "else nothing is stated as a fact"
    other = Truth({**TRUTH, "coil1.axial_loops": 14.0}, (), np.zeros((36, 3), dtype=bool))
    known = {"coil1.radial_loops": 3.0}
    right = Truth({**TRUTH, **known}, (), np.zeros((36, 3), dtype=bool))
    assert all(are_true(told(printed, truth=right), "loop_counts"))
    assert not any(
        are_true(told(printed, truth=replace(other, values={**other.values, **known})), "loop_counts")
    )


def test_currents_are_said_to_change_too_little_only_where_they_do(told, printed, monkeypatch):
    assert are_true(told(printed), "too_little_change") == [True]
    right = Case.observations.func  # type: ignore[attr-defined]

    def other(case: Case) -> Observations:
        readings = right(case)
        current_A = readings.current_A.clone()
        current_A[0] *= -1.0
        return replace(readings, current_A=current_A)

    monkeypatch.setattr(Case, "observations", property(other))
    assert are_true(told(printed), "too_little_change") == [False]


def test_what_is_fitted_everywhere_has_a_truth():
    names = ["background_field[room].x_T", "sensor_offset[hall].z_T", "coil1.radius_m", "other.radius_m"]
    field = TrueCause("background_field", "room", True, 9.0, {"x_T": 2e-5})
    none = {"background_field[room].x_T": 0.0, "sensor_offset[hall].z_T": 0.0}
    own = {"coil1.radius_m": TRUTH["coil1.radius_m"]}
    assert hidden().numbers(names) == own | none
    assert hidden(field).numbers(names) == own | none | {"background_field[room].x_T": 2e-5}
    assert hidden(OUTSIDE).numbers(names) == own


def test_a_distance_from_a_prior_is_computed_anew(told, small_calibration):
    prior = small_calibration.rig.parameters["coil1.radius_m"].prior
    assert prior is not None
    distance = prior.distance(float(np.median(small_calibration.draws["coil1.radius_m"])))
    words = "coil1.radius_m lies {:+.1f} prior standard deviations from its prior's centre: narrow prior"
    assert are_true(told(words.format(distance)), "tension") == [True]
    assert are_true(told(words.format(distance + 1.0)), "tension") == [False]


NOTHING = "These readings show nothing wrong"
DOUBTS = "Nothing is sure enough to be named, but it is only < 1 % probable that nothing is wrong."
MAYBE = "  {} (97 %), or something not in the library (3 %)"
PLATE = NAMED | {"name": "iron_plate"}


def maybe(name: str, unknown: float) -> dict[str, Any]:
    """A cause, or with some probability something that is not in the library."""
    return NAMED | {"name": name, "p_not_in_library": unknown}


def in_family(link: str, unknown: float) -> dict[str, Any]:
    """An interference, or something else at a link."""
    return maybe("periodic_interference", unknown) | {"family": {"links": [link], "probability": 0.95}}


def sized(median: float) -> dict[str, Any]:
    interval = {"median": median, "sd": 0.001, "ci90": [median - 0.0016, median + 0.0016]}
    return NAMED | {"parameters": {"x": interval}}


@pytest.mark.parametrize(
    ("kind", "words", "causes", "truth", "is_true"),
    [
        ("name", "verdict: named", [NAMED], ONLY_GAIN, True),
        ("name", "verdict: named", [PLATE], ONLY_GAIN, False),
        ("name", "verdict: partly_explained", [NAMED], hidden(OUTSIDE), False),
        ("name", "verdict: partly_explained", [NAMED], WITH_OUTSIDE, True),
        ("name", "verdict: partly_explained", [NAMED], hidden(), False),
        # Of a doubtful name its family is told: a moved chair acts in the room as well.
        ("name", "verdict: partly_explained", [in_family("room", 0.2)], hidden(OUTSIDE), True),
        ("name", "verdict: partly_explained", [in_family("room", 0.02)], hidden(OUTSIDE), False),
        ("name", "verdict: partly_explained", [in_family("zero", 0.2)], hidden(GAIN), False),
        ("cause_probability", MAYBE.format("axis_gain"), [maybe("axis_gain", 0.03)], ONLY_GAIN, True),
        # Three per cent were left for anything else.
        ("cause_probability", MAYBE.format("iron_plate"), [maybe("iron_plate", 0.03)], ONLY_GAIN, True),
        ("cause_probability", MAYBE.format("iron_plate"), [maybe("iron_plate", 0.001)], ONLY_GAIN, False),
        # A relative of a moved chair.
        ("cause_probability", MAYBE.format("iron_plate"), [maybe("iron_plate", 0.001)], hidden(OUTSIDE), True),
        ("cause_probability", MAYBE.format("axis_gain"), [maybe("axis_gain", 0.001)], hidden(OUTSIDE), False),
        ("cause_probability", MAYBE.format("axis_gain"), [maybe("axis_gain", 0.001)], hidden(), False),
        ("size", "", [sized(0.0101)], ONLY_GAIN, True),
        ("size", "", [sized(0.0201)], ONLY_GAIN, False),
        ("nothing_wrong", f"{NOTHING}.", [], hidden(), True),
        ("nothing_wrong", f"{NOTHING}.", [], ONLY_GAIN, False),
        ("nothing_wrong", f"{NOTHING}.", [], SMALL_GAIN, True),
        ("nothing_wrong", f"{NOTHING}.", [], hidden(wrong=(4,)), False),
        ("would_have_shown", f"{NOTHING}; they would have shown, for example, axis_gain x from 2 %.", [], SMALL_GAIN, True),
        ("would_have_shown", f"{NOTHING}; they would have shown, for example, axis_gain x from 0.5 %.", [], SMALL_GAIN, False),
        ("doubts", DOUBTS, [], hidden(), False),
        ("doubts", DOUBTS, [], ONLY_GAIN, True),
    ],
)  # fmt: skip
def test_a_statement_is_judged_by_what_is_hidden(told, kind, words, causes, truth, is_true):
    assert are_true(told("", words, truth, causes=causes), kind) == [is_true]


def test_nothing_to_mend_is_false_where_the_rig_as_it_is_gives_false_intervals(told, small_calibration):
    words = "There is nothing to mend: use the rig file as it is."
    assert are_true(told("", words), "nothing_wrong") == [True]
    assert are_true(told("", words, wrong_truth(small_calibration)), "nothing_wrong") == [False]


@pytest.mark.parametrize(("readings", "is_true"), [([3, 4], True), ([3, 4, 5], False)])
def test_every_flagged_reading_is_wrong(told, readings, is_true):
    statements = told("", "", hidden(wrong=(2, 3)), flagged=[FLAG | {"readings": readings}])
    assert are_true(statements, "flag") == [is_true]


@pytest.mark.parametrize(("off_sigma", "is_true"), [(9.0, True), (1.0, False)])
def test_an_outlier_is_far_from_what_is_true(told, small_session, off_sigma, is_true):
    expected_T = small_session.observations.field_sensor_T.numpy().copy()
    expected_T[2, 0] += off_sigma * 5e-6
    truth = replace(hidden(), expected_T=expected_T, noise_T=np.full(36, 5e-6))
    assert are_true(told("", "", truth, outliers=[OUTLIER]), "outlier") == [is_true]


@pytest.mark.parametrize(("before", "is_true"), [("53.80 ± 0.10", True), ("51.85 ± 0.10", False)])
def test_a_parameter_that_was_right_is_not_biased(told, before, is_true):
    row = ["radius", before, "51.80 ± 0.90", "mm", "−20.0"]
    assert are_true(told("", "", hidden(GAIN), moved=row), "biased") == [is_true]
    assert "biased" not in told("", "", hidden(GAIN), moved=[*row[:4], NO_LONGER_DETERMINED])


def test_the_error_on_unseen_readings_is_that_of_what_was_handed_out(told, unseen_uT):
    words = "On {} readings that no fit has seen the rms error falls from 300 µT to {:.3g} µT."
    statements = told("", words.format(9, unseen_uT))
    assert are_true(statements, "unseen_error") == are_true(statements, "unseen_number") == [True]
    statements = told("", words.format(8, 1.1 * unseen_uT))
    assert are_true(statements, "unseen_error") == are_true(statements, "unseen_number") == [False]


def test_an_error_that_does_not_fall_is_no_gain(told, unseen_uT):
    words = "On 9 readings that no fit has seen the rms error falls from {:.4g} µT to {:.3g} µT."
    assert are_true(told("", words.format(3.0 * unseen_uT, unseen_uT)), "gain") == [True]
    assert are_true(told("", words.format(1.001 * unseen_uT, 0.1 * unseen_uT)), "gain") == [False]


def test_the_last_line_is_that_of_what_was_handed_out(told, unseen_uT):
    words = (
        "unseen readings: 300 -> {:.4g} uT rms of the vector; coverage of 90 % intervals 20.0 % -> {:.1f} %; "
        "log predictive density +3.0 +- 1.0"
    )
    statements = told("", words.format(unseen_uT, 90.0))
    assert are_true(statements, "unseen_error") == are_true(statements, "coverage") == [True]
    statements = told("", words.format(0.9 * unseen_uT, 40.0))
    assert are_true(statements, "unseen_error") == are_true(statements, "coverage") == [False]


def test_the_first_sentence_does_not_quote_what_fitted_readings_leave(told, unseen_uT):
    words = "Something is wrong: the rig as described misses by 300 µT rms, the extended rig by {:.3g} µT"
    component_uT = unseen_uT / np.sqrt(3.0)
    assert are_true(told("", words.format(component_uT)), "first_sentence") == [True]
    assert are_true(told("", words.format(0.1 * component_uT)), "first_sentence") == [False]


def test_numbers_far_from_their_priors_are_those_of_what_was_handed_out(told, small_calibration):
    prior = small_calibration.rig.parameters["coil1.radius_m"].prior
    assert prior is not None
    distance = prior.distance(float(np.median(small_calibration.draws["coil1.radius_m"])))
    words = "Far from what the rig file expects: radius is 51.8 mm where 51 is expected, {:+.1f} widths of its prior."
    assert are_true(told("", words.format(distance)), "tension") == [True]
    assert are_true(told("", words.format(distance + 2.0)), "tension") == [False]


def test_intervals_of_what_was_handed_out_hold_the_truth(told, small_calibration):
    assert are_true(told(), "extended_intervals") == [True]
    assert are_true(told("", "", wrong_truth(small_calibration)), "extended_intervals") == [False]


def test_a_line_that_nobody_judges_is_counted(told, folder):
    told("", "verdict: named\nThe moon is made of 3.5 kg of cheese.")
    _, unread = judged(Case(folder, hidden()))
    assert unread == ["The moon is made of # kg of cheese."]


@pytest.mark.parametrize(
    ("code", "error", "truth", "kind", "is_true"),
    [
        (1, "Traceback\nKeyError: 'x'", hidden(GAIN), "crash", False),
        (2, "coilcal: units look like mm", hidden(GAIN), "refused", True),
        (2, "coilcal: units look like mm", hidden(), "refused", False),
    ],
)
def test_a_crash_is_false_and_so_is_the_refusal_of_a_clean_session(
    tmp_path, code, error, truth, kind, is_true
):
    (statement,) = ended(Case(tmp_path, truth), "calibrate.txt", (code, "", error), "calibrate")
    assert (statement.kind, statement.is_true) == (kind, is_true)


def test_predictions_are_those_of_the_field_at_the_sensor(folder, small_calibration):
    """One reading after another, by the public method."""
    readings = small_calibration.observations
    shown_T = HandedOut.of_folder(folder / "calibration").readings_T(readings)
    points_m = readings.field_sensor_T.new_zeros(1, 3)
    for i in (0, 7, 35):
        motion = {name: rows[i] for name, rows in readings.motion.items()}
        field_T = small_calibration.field(points_m, {"coil1": float(readings.current_A[i, 0])}, motion)
        assert np.allclose(field_T[0], shown_T[i], rtol=1e-9, atol=0.0)


def test_intervals_far_from_the_truth_are_counted(folder, small_calibration):
    model = HandedOut.of_folder(folder / "calibration")
    missed, n = missed_90(model, hidden())
    assert n == 3
    excluded = wrong_truth(small_calibration)
    assert set(false_intervals(model, excluded)) == {"coil1.radius_m"}
    assert missed_90(model, excluded) == (missed + 1, n)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_session_has_its_truth(kind, tmp_path):
    truth = hidden_case(kind, 900_001, tmp_path)
    assert truth.is_clean == (kind == "clean")
    assert all(cause.is_known == (cause.name in EFFECTS) for cause in truth.causes)
    assert truth.wrong.any() or kind not in (sessions.ROWS, sessions.PLACES)
    assert (tmp_path / "readings.csv").exists()


def test_false_statements_are_counted_by_kind(capsys):
    said = [Statement("good", "calibrate", "good: ...", False, "radius is 12 sd off")]
    said += [Statement("error", "calibrate", "error 3 uT", True, "")] * 3
    said += [Statement("loop_counts", "calibrate", "if nothing is wrong", False, "", aside="condition")]
    said += [Statement("unlisted_at", "diagnose", "odds 4 to 1", False, "", None, 0.8, "probability")] * 5
    row = {"kind": "single", "seed": 7, "name": "7", "hidden": "axis_gain of hall", "unread": ["# cheeses"]}
    row |= {
        "verdicts": ["good", "named"],
        "statements": [one.to_json() for one in said],
        "missed_90": {"calibrate": [1, 3]},
    }
    show([row, {"kind": "clean", "seed": 8, "error": "KeyError: 1"}])
    printed = capsys.readouterr().out
    assert "1 sessions, 4 statements judged, 1 false" in printed
    assert "in a thousand: 250.0" in printed
    assert "under conditions that do not hold: 1 statements, 1 would be false" in printed
    assert "unlisted_at: 0 of 5 stated with a probability are true, 4.0 expected" in printed
    assert "radius is 12 sd off" in printed
    assert "not judged: clean 8: KeyError: 1" in printed
    assert "1 # cheeses" in printed
    assert "1 of 10 false" in line(row)

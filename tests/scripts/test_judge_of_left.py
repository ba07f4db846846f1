"""The judge of sentences on what no name explains, and on what they depend on, catches false ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator import load_rig
from estimator.model.measurement_model import nominal_tensors
from estimator.readings.metrics import error_metrics
from estimator.readings.observations import Observations
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.judge import of_calibration
from scripts.studies.judge.case import Case
from scripts.studies.judge.handed_out import HandedOut
from scripts.studies.judge.independent import missed_T
from scripts.studies.judge.sessions import hidden_case
from scripts.studies.judge.truth import TrueCause, Truth
from tests.estimator.conftest import TRUTH
from tests.scripts.judged import (
    GAIN,
    NAMED,
    ONLY_GAIN,
    OUTSIDE,
    SMALL_GAIN,
    WITH_OUTSIDE,
    are_true,
    hidden,
    wrong_truth,
)

pytestmark = pytest.mark.whole
UNKNOWN = "Something is wrong, and no known cause is probable: how far readings miss depends on time."
PROBABLY = "Something is probably wrong (94 %), and no cause is sure enough to be stated: how far readings miss depends on time."
BESIDE = "Something else is left, for which no listed cause is probable. {}"
NOWHERE = "The readings do not tell where it acts."
ODDS = "odds {} to 1 that something acts beside what is stated; it looks like a change in {}"
ROOM, ZERO, RESPONSE = (
    "the field of the room",
    "what a sensor shows without a field",
    "what a sensor makes of the field",
)
BEST = "What is left is best described so: the room wanders (room_wanders, 92 %) or the zero wanders (zero_wanders, {} %)."
STOPS = "What is left is best described so: at each stop the mover stands off (stop_errors of 0.75 mm rms, 27 in all, 95 %)."
SWAPPED = "The sensor's axes are in another order or direction (axes_swapped)."
MIRRORED = TrueCause("axes_swapped", "hall", True, None, {})
UNSEEN = (
    "These readings could not have shown, for example: the sensor's axes have wrong gains (axis_gain[hall]), up to x {} %: "
    "radius would absorb it, and be wrong by up to {:.0f} µm (4 standard deviations). Where nothing of that kind can be, use it."
)
BALL = "cubed radius of a ball {} cm³ (19 to 134 cm³), a ball of 35 mm radius"


@pytest.mark.parametrize(
    ("kind", "words", "causes", "truth", "is_true"),
    [
        ("no_known_cause", UNKNOWN, [], hidden(), False),
        ("no_known_cause", UNKNOWN, [], ONLY_GAIN, False),
        ("no_known_cause", UNKNOWN, [], hidden(OUTSIDE), True),
        ("no_known_cause", UNKNOWN, [], hidden(wrong=(4,)), True),
        ("no_known_cause", BESIDE.format(NOWHERE), [], ONLY_GAIN, False),
        ("no_known_cause", BESIDE.format(NOWHERE), [], WITH_OUTSIDE, True),
        ("something_wrong", UNKNOWN, [], hidden(), False),
        ("something_wrong", UNKNOWN, [], ONLY_GAIN, True),
        ("something_wrong", PROBABLY, [], hidden(), False),
        ("unlisted_at", BESIDE.format(f"It acts in {ROOM} (> 99 %)."), [], WITH_OUTSIDE, True),
        ("unlisted_at", BESIDE.format(f"It acts in {RESPONSE} (> 99 %)."), [NAMED], WITH_OUTSIDE, False),
        ("unlisted_at", ODDS.format("beyond a billion", ROOM), [NAMED], WITH_OUTSIDE, True),
        # A listed cause of that link counts, unless the verdict names it.
        ("unlisted_at", ODDS.format("40,000", RESPONSE), [], ONLY_GAIN, True),
        ("unlisted_at", ODDS.format("40,000", RESPONSE), [NAMED], ONLY_GAIN, False),
        ("unlisted_at", ODDS.format("40,000", ZERO), [NAMED], ONLY_GAIN, False),
        ("unlisted_at", ODDS.format("40,000", RESPONSE), [], hidden(), False),
        ("unlisted_at", BEST.format(8), [], hidden(OUTSIDE), True),
        ("unlisted_at", BEST.format(8), [], ONLY_GAIN, False),
        ("unlisted_at", STOPS, [], ONLY_GAIN, False),
        ("not_sure", "Not sure enough to be stated: gains are wrong (axis_gain, 60 %).", [], ONLY_GAIN, True),
        ("not_sure", "Not sure enough to be stated: gains are wrong (axis_gain, 60 %).", [], hidden(OUTSIDE), False),
        ("mistake", SWAPPED, [], hidden(MIRRORED), True),
        ("mistake", SWAPPED, [], ONLY_GAIN, False),
        ("not_shown", UNSEEN.format(2, 1.0), [], ONLY_GAIN, False),
        ("not_shown", UNSEEN.format(0.5, 1.0), [], ONLY_GAIN, True),
        ("not_shown", UNSEEN.format(2, 1.0), [], SMALL_GAIN, True),
        ("ball", BALL.format(42), [], hidden(), True),
        ("ball", BALL.format(84), [], hidden(), False),
    ],
)  # fmt: skip
def test_what_is_left_is_judged_by_what_is_hidden(told, kind, words, causes, truth, is_true):
    assert are_true(told("", words, truth, causes=causes), kind) == [is_true]


def test_odds_are_counted_by_what_they_promise(told):
    small, large = (told("", ODDS.format(n, ROOM))["unlisted_at"][0] for n in (4, 40_000))
    assert (small.is_true, small.aside, small.stated) == (False, "probability", 0.8)
    assert (large.is_true, large.aside) == (False, None)


def test_what_is_said_under_a_condition_is_judged_where_that_holds(told, small_calibration):
    words = "Something in the rig file may be wrong; numbers, intervals and probabilities hold only if nothing is."
    wrong = wrong_truth(small_calibration)
    for truth, aside in ((wrong, None), (replace(wrong, causes=(GAIN,)), "condition")):
        statement = told(words, truth=truth)["intervals_if"][0]
        assert (statement.is_true, statement.aside) == (False, aside)
    best = small_calibration.summary()["loop_counts"][0]
    counts = f"coil1: {best['axial']} x {best['radial']} loops with probability > 99 % if nothing is wrong"
    other = Truth({**TRUTH, "coil1.axial_loops": 99.0}, (), np.zeros((36, 3), dtype=bool))
    for truth, aside in ((other, None), (replace(other, causes=(GAIN,)), "condition")):
        statement = told(counts, truth=truth)["loop_counts"][0]
        assert (statement.is_true, statement.aside) == (False, aside)


@pytest.mark.parametrize(("cause", "aside"), [("axis_gain", None), ("iron_plate", "condition")])
def test_intervals_of_an_extended_rig_hold_if_its_cause_is_what_is_wrong(
    told, small_calibration, monkeypatch, cause, aside
):
    quality = {"verdict": "suspect", "reasons": [f"it holds only if {cause} is what is wrong (86 %)."]}
    summary = {**small_calibration.summary(), "quality": quality}
    monkeypatch.setattr(Case, "extended_summary", property(lambda _: summary))
    wrong = replace(wrong_truth(small_calibration), causes=(GAIN,))
    (statement,) = told("", "", wrong)["extended_intervals"]
    assert (statement.is_true, statement.aside) == (False, aside)


def test_how_far_the_rig_misses_is_that_of_the_calibration(told, unseen_uT):
    words = "Something is wrong, and no known cause is probable: the rig as described misses readings that no fit has seen by "
    words += "{:.3g} µT rms where the expected noise leaves {} µT, mostly in x of hall."
    statements = told("", words.format(unseen_uT, 8.66), ONLY_GAIN)
    assert are_true(statements, "missed") == are_true(statements, "expected_noise") == [True]
    wrong = told("", words.format(1.2 * unseen_uT, 17), ONLY_GAIN)
    assert are_true(wrong, "missed") == are_true(wrong, "expected_noise") == [False]


@pytest.mark.parametrize(("axis", "is_true"), [("x", False), ("z", True)])
def test_most_is_wrong_in_the_component_that_misses_most(told, monkeypatch, axis, is_true):
    right = HandedOut.readings_T
    off_T = torch.tensor([1e-5, 0.0, 1e-3], dtype=torch.float64)
    monkeypatch.setattr(HandedOut, "readings_T", lambda self, *readings: right(self, *readings) + off_T)
    words = f"the rig as described misses readings that no fit has seen by 1 mT rms where the expected noise leaves 8.7 µT, mostly in {axis} of hall."
    assert are_true(told("", words), "mostly") == [is_true]


CORRECTIONS = """
corrections:
  room_harmonics[room]:
    {middle_x_m: 0, middle_y_m: 0, middle_z_m: 0, reach_m: 1, degree1_cos0_T: 1.0e-4, degree1_cos1_T: 0, degree1_sin1_T: 0}
  gain_steps[hall]: {above_T: 1.0e-5, degree1_share: 0.01}
"""


def test_corrections_are_those_of_the_extended_rig(told, folder):
    path = folder / "diagnosis" / "rig_extended.yaml"
    before = path.read_text(encoding="utf-8")
    path.write_text(before + CORRECTIONS, encoding="utf-8")
    by, too = "Predictions are corrected, not explained, by {}.", "Fitted too, but no part of the field: {}."
    room, gain = "room_harmonics to degree 1", "gain_steps[hall] to degree 1"
    try:
        assert are_true(told("", by.format(room)), "corrected") == [True]
        assert are_true(told("", by.format(f"{gain}; {room}")), "corrected") == [False, True]
        assert are_true(told("", too.format(gain)), "fitted_too") == [True]
        assert are_true(told("", too.format(room)), "fitted_too") == [False]
        assert are_true(told("", too.format("gain_steps[hall, other] to degree 1")), "fitted_too") == [False]
        assert are_true(told("", too.format("field_remembered to degree 1")), "fitted_too") == [False]
    finally:
        path.write_text(before, encoding="utf-8")


def test_what_absorbs_a_cause_is_as_sure_as_is_said(told, small_calibration):
    sd_um = 1e6 * float(small_calibration.draws["coil1.radius_m"].std())
    assert are_true(told("", UNSEEN.format(2, 4.0 * sd_um)), "absorbed") == [True]
    assert are_true(told("", UNSEEN.format(2, 12.0 * sd_um)), "absorbed") == [False]


def test_readings_are_said_to_be_far_from_the_nominal_model_only_where_they_are(told, monkeypatch):
    right = Case.observations.func  # type: ignore[attr-defined]
    off_T = torch.zeros(36, 3, dtype=torch.float64)

    def other(case: Case) -> Observations:
        readings = right(case)
        field_T = readings.field_sensor_T + off_T
        return replace(readings, field_sensor_T=field_T, line=torch.arange(2, 38))

    monkeypatch.setattr(Case, "observations", property(other))
    words = "Lines 4, 5: much farther from the rig's nominal model than the others (readings.csv)."
    assert are_true(told(words, truth=hidden(wrong=(2, 3))), "far_lines") == [False]
    off_T[2:4] = 0.1
    assert are_true(told(words, truth=hidden(wrong=(2, 3))), "far_lines") == [True]
    words = f"{words}\nThe other fields correlate with the rig's nominal model by 0.99 only: a place may be wrong (readings.csv)."
    assert are_true(told(words, truth=ONLY_GAIN), "correlation") == [True]
    assert are_true(told(words.partition("\n")[2], truth=ONLY_GAIN), "correlation") == [False]
    off_T[:] = 0.0
    words = "Fields correlate with the rig's nominal model by {} only: a place may be wrong (readings.csv)."
    assert are_true(told(words.format("0.99"), truth=ONLY_GAIN), "correlation") == [True]
    assert are_true(told(words.format("0.99")), "correlation") == [False]
    assert are_true(told(words.format("0.41"), truth=ONLY_GAIN), "correlation") == [False]
    words = (
        "Fields point against the rig's nominal model: a current or an axis may be reversed (readings.csv)."
    )
    assert are_true(told(words, truth=hidden(MIRRORED)), "against") == [False]


def test_a_coil_without_a_current_has_none(told):
    words = "coil1 carries no current in any reading: of its own field all that is known is what the rig file says."
    assert are_true(told(words), "idle_coil") == [False]


@pytest.mark.parametrize("kind", ["clean", "open"])
def test_other_code_predicts_what_is_handed_out(kind, tmp_path):
    """At the numbers of the rig file and at wrong ones: an error that is printed of others is caught."""
    hidden_case(kind, 900_002, tmp_path)
    rig = load_rig(tmp_path / "rig.yaml")
    readings = read_readings_csv(tmp_path / "readings.csv", rig).observations
    shown_T = HandedOut(rig, nominal_tensors(rig)).readings_T(readings).numpy()
    best = rig.nominal_values()
    asked = readings.is_validation.numpy()
    assert missed_T(tmp_path, best, shown_T, asked) < 1e-6 * np.abs(shown_T).max()
    measured_T = readings.field_sensor_T.numpy()
    off_T = missed_T(tmp_path, best, measured_T, asked)
    assert off_T == pytest.approx(error_metrics(measured_T[asked], shown_T[asked]).vector_T, rel=1e-5)
    assert missed_T(tmp_path, best | {"axis_gain[hall].x": 0.1}, measured_T, asked) is None


def test_an_error_that_loops_of_other_code_do_not_give_is_false(
    told, printed, monkeypatch, small_calibration
):
    error_T = small_calibration.summary()["rmse"]["validation"]["vector_T"]
    for factor, is_true in ((1.0, True), (1.02, False)):
        monkeypatch.setattr(of_calibration, "missed_T", lambda *_, factor=factor: factor * error_T)
        assert are_true(told(printed), "error_by_loops") == [is_true]

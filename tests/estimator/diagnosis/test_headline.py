"""The first sentences of a report say what the readings say, and no more."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch

from estimator.diagnosis.budget import Budget, Share
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.headline import headline, warnings_of
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.comparison import Comparison
from estimator.diagnosis.mixture.links import Link
from estimator.diagnosis.mixture.slots import Slots
from estimator.diagnosis.next_readings.resolution import Visible
from estimator.diagnosis.panels import panels
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.sizes import Interval
from estimator.diagnosis.statements.gain import unseen_line
from estimator.diagnosis.statements.left import unexplained
from estimator.diagnosis.statements.priors import held_back
from estimator.diagnosis.validation import Improvement, improvement_of
from estimator.diagnosis.verdict import Family, NamedCause, Verdict
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.readings.observations import Observations
from estimator.reporting.numbers import size_with_unit
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause
from estimator.store.session import Session
from tests.estimator.diagnosis.reported import GAIN, HEATING, OFFSET, STEPS, WANDERS, said_instead
from tests.estimator.diagnosis.small_fits import OFFSET_T

pytestmark = [pytest.mark.whole, pytest.mark.usefixtures("names_are_right")]


TRUE_Z_M = -0.0425  # of the small session


def test_first_box_says_it_in_at_most_four_sentences(diagnosis):
    assert 2 <= len(headline(diagnosis)) <= 4


def test_second_sentence_gives_the_size_with_its_interval(diagnosis):
    found = re.search(r"intervals: x (\d+) µT \((\d+) to (\d+) µT\)\.", headline(diagnosis)[1])
    assert found is not None
    size, low, high = (float(number) for number in found.groups())
    assert low < size < high
    assert low < 1e6 * OFFSET_T < high


def test_where_nothing_is_found_the_smallest_visible_sizes_are_said(diagnosis):
    calm = replace(diagnosis, verdict=Verdict.NOTHING_FOUND)
    first = headline(calm)[0]
    assert re.match(
        r"These readings show nothing wrong \(\d+ %\); they would have shown, for example, ", first
    )
    assert len(re.findall(r" from [\d.]+ \S", first)) == 3  # of the coil, the sensor and the mover
    near = {"axis": 0.0, "distance_m": 0.035}
    far = {"axis": 2.0, "distance_m": -0.19}
    plate = Visible(
        Cause("iron_plate", "room"),
        "strength",
        "1",
        0.01,
        0.5,
        near,
        0.1,
        (),
        740.0,
        "coil1.turns",
        0.5,
        far,
        -3.6,
        36.0,
    )
    left_open = replace(calm.left_open, next_measurements=(), visible=(*calm.left_open.visible, plate))
    last = headline(replace(calm, left_open=left_open))[-1]
    assert last.startswith("These readings could not have shown, for example: ")
    assert (
        "(iron_plate[room]), up to strength 50 % at z = −190 mm: turns would absorb it, and be wrong by up to 10 % (740 standard deviations)"
        in last
    )
    assert 2 <= last.count(" would absorb it, ") <= 4  # of the room, a coil, a sensor and a mover one each
    assert last.endswith("Where nothing of that kind can be, use the rig file as it is.")
    nothing = replace(left_open, visible=())
    assert headline(replace(calm, left_open=nothing))[-1] == (
        "Nothing that these readings show asks for another rig file."
    )


def test_nothing_found_says_where_nothing_wrong_is_hardly_probable(diagnosis):
    last = diagnosis.findings.answer.comparisons[-1]

    def told(p_nothing: float) -> list[str]:
        shares = {"nothing": p_nothing, "axis_gain[hall]": 1.0 - p_nothing}
        hypotheses = tuple(replace(h, probability=shares.get(h.name, 0.0)) for h in last.hypotheses)
        doubtful = Comparison(last.asked, last.beside)
        doubtful.__dict__["hypotheses"] = tuple(sorted(hypotheses, key=lambda h: -h.probability))
        answer = replace(diagnosis.findings.answer)
        answer.__dict__["comparisons"] = (doubtful,)
        findings = replace(diagnosis.findings, answer=answer, causes=())
        left_open = replace(diagnosis.left_open, next_measurements=())
        clean = replace(diagnosis, verdict=Verdict.NOTHING_FOUND, findings=findings, left_open=left_open)
        return headline(clean)

    assert told(0.5)[0].startswith("These readings show nothing wrong")
    doubtful = told(0.07)
    assert doubtful[0].startswith("Nothing is sure enough to be named, but it is only 7 % probable")
    assert "axis_gain 93 %" in doubtful[0]
    assert doubtful[-1].startswith("Measure again")


def gain_with(diagnosis: Diagnosis, readings: Observations, *causes: Cause) -> tuple[Improvement, str, Fit]:
    """Improvement by some causes, on the readings to which they are fitted, its sentence, and the fit."""
    rig, rules = diagnosis.fits.plain.rig, diagnosis.fits.plain.posterior.model.rules
    before = fit_rig(rig, readings, {}, rules)
    for cause in causes:
        rig = with_effect(rig, cause, readings, {})
    final = fit_rig(rig, readings, {}, rules)
    improvement = improvement_of(before, final, readings)
    fits = replace(diagnosis.fits, final=final, extended=final, improvement=improvement)
    sentences = headline(replace(diagnosis, fits=fits))
    return improvement, next(words for words in sentences if words.startswith("On ")), final


def test_what_acts_in_readings_alone_is_told_beside_their_error(diagnosis):
    """A zero of a sensor; not a field of the room, which a prediction has."""
    readings = diagnosis.fits.plain.observations
    _, both, _ = gain_with(diagnosis, readings, OFFSET, Cause("background_field", "room"))
    assert (
        "It includes what sensors and movers do wrong (sensor_offset); predict gives the field without it."
        in both
    )
    assert "That is with" not in gain_with(diagnosis, readings, Cause("background_field", "room"))[1]


def test_a_drift_that_is_named_is_in_no_predicted_field_which_is_told_with_its_own_error(diagnosis):
    plain, drift = diagnosis.fits.plain, Cause("background_drift", "room")
    readings, hours = plain.observations, plain.posterior.model.circumstances.hours
    drift_T = 3e-4 * (hours / hours.max())[:, None] * torch.tensor([1.0, -1.0, 0.5], dtype=torch.float64)
    drifting = readings.with_field(readings.field_sensor_T + drift_T)
    improvement, words, final = gain_with(diagnosis, drifting, drift)
    assert improvement.not_predicted == (drift,)
    scores = improvement.after
    beside_T = (scores.predicted.vector_T**2 - scores.errors.vector_T**2) ** 0.5
    rate_T_per_h = math.hypot(
        *(float(final.values[f"background_drift[room].{axis}_T_per_h"]) for axis in "xyz")
    )
    assert beside_T == pytest.approx(rate_T_per_h * float(hours.square().mean().sqrt()), rel=0.1)
    assert scores.predicted_coverage90 < 0.5 * scores.coverage90
    missed = size_with_unit(scores.predicted.vector_T, "T", 3)
    lacking = "It includes what predictions are without (background_drift)"
    assert f"{lacking}: they miss these readings by {missed}; the field itself may be right." in words
    assert f"-> {scores.predicted.vector_T * 1e6:.4g} uT" in unseen_line(improvement)
    of_model = unseen_line(improvement, is_extended=False)
    assert of_model.startswith(
        f"unseen readings: {scores.predicted.vector_T * 1e6:.4g} uT rms of the vector; coverage of 90 % intervals "
    )
    assert "->" not in of_model


def test_an_error_that_does_not_fall_is_not_said_to_fall(diagnosis):
    improvement = diagnosis.improvement
    assert improvement is not None
    assert improvement.is_significant
    assert any("falls from" in sentence for sentence in headline(diagnosis))
    scattered = replace(improvement, after=replace(improvement.after, errors=improvement.before.errors))
    told = headline(replace(diagnosis, fits=replace(diagnosis.fits, improvement=scattered)))
    assert any("does not fall (" in sentence and "log predictive density +" in sentence for sentence in told)
    assert not any("falls from" in sentence for sentence in told)


def test_intervals_that_hold_too_few_unseen_readings_are_told_with_their_error(diagnosis):
    improvement = diagnosis.improvement
    assert improvement is not None
    n = len(improvement.after.log_density)

    def told(coverage90: float) -> str:
        after = replace(improvement.after, coverage90=coverage90)
        fits = replace(diagnosis.fits, improvement=replace(improvement, after=after))
        return " ".join(headline(replace(diagnosis, fits=fits)))

    narrow = 0.9 - 3.5 * (0.09 / n) ** 0.5
    words = f", and 90 % intervals hold only {100.0 * narrow:.0f} % of their components: they are too narrow."
    assert words in told(narrow)
    assert "too narrow" not in told(0.9 - 2.5 * (0.09 / n) ** 0.5)


def test_few_unseen_readings_cannot_say_that_intervals_are_too_wide(diagnosis):
    """Nine of nine lie in right 90 % intervals with a probability of 0.39, two hundred of two hundred with 1e-9."""
    improvement = diagnosis.improvement
    assert improvement is not None

    def told(n: int) -> list[str]:
        after = replace(improvement.after, coverage90=1.0, log_density=torch.zeros(n, dtype=torch.float64))
        fits = replace(diagnosis.fits, improvement=replace(improvement, after=after))
        return [words for words in warnings_of(replace(diagnosis, fits=fits)) if "too wide" in words]

    assert told(9) == []
    assert told(200) == [
        "The 90 % predictive intervals contain 100 % of the components of unseen readings: they are too wide."
    ]


def test_a_mistake_of_the_record_is_told_with_what_else_it_may_be(diagnosis):
    """A round coil on its axis of mirrors: a reversed axis of the sensor or of the displacements makes the same readings."""
    swapped, mirrored = Cause("axes_swapped", "hall"), Cause("left_handed", "arm1")

    def told(*twins: tuple[Cause, float]) -> str:
        mistake = NamedCause.among({swapped: 0.0, **dict(twins)}, 900.0)
        return headline(
            replace(diagnosis, findings=replace(diagnosis.findings, record_mistakes=(mistake,), causes=()))
        )[0]

    assert told() == "The sensor's axes are in another order or direction (axes_swapped)."
    assert told((mirrored, 0.0)) == (
        "The sensor's axes are in another order or direction (axes_swapped, 50 %), or one axis of a mover, or all three, "
        "is reversed: its frame is left-handed (left_handed, 50 %)."
    )


def test_what_a_mistake_of_the_record_makes_of_columns_is_told(diagnosis, monkeypatch):
    reads = {"x_reads": 3.0, "y_reads": -2.0, "z_reads": 1.0}
    sizes = {key: Interval(value, 0.0, (value, value), "1") for key, value in reads.items()}
    monkeypatch.setattr(Diagnosis, "quantities", lambda self, cause: sizes)
    mistakes = (NamedCause(Cause("positions_swapped", "arm1"), 1.0, (), 900.0),)
    swapped = replace(diagnosis, findings=replace(diagnosis.findings, record_mistakes=mistakes, causes=()))
    assert headline(swapped)[0] == (
        "The mover's columns x, y and z are in another order or direction (positions_swapped): x, y and z hold z, −y and x."
    )
    told = replace(swapped, verdict=Verdict.NAMED, left_open=replace(swapped.left_open, next_measurements=()))
    assert any(words.startswith("Put the record right and import it again") for words in headline(told))


def test_a_size_that_its_prior_holds_back_is_said_with_what_the_readings_alone_say(diagnosis):
    """Half of the information from the prior: the readings alone would say twice as much."""
    assert list(held_back(diagnosis)) == []
    (sized, *_) = diagnosis.sized_causes
    half = Interval(1e-4, 5e-6, (9e-5, 1.1e-4), "T")
    prior = Normal(0.0, 5e-6 * 2**0.5)
    parameter = diagnosis.extended_rig.parameters[f"{sized.cause.label}.x_T"]
    rig = diagnosis.extended_rig.with_parameters([replace(parameter, prior=prior)])
    held = SimpleNamespace(sized_causes=(replace(sized, quantities={"x_T": half}),), extended_rig=rig)
    (sentence,) = held_back(cast("Diagnosis", held))
    assert "holds back its x, 100 µT with a prior of ± 7.1 µT, about 200 µT without" in sentence


def test_a_number_far_outside_its_prior_is_told_first_and_what_to_do(small_rig, small_session):
    """The prior holds the fit back, but the sentence says how far off the number truly is."""
    stated = small_rig.parameters["coil1.world_from_coil0.z_m"]
    prior = Normal(TRUE_Z_M - 8e-4, 1e-4)
    rig = small_rig.with_parameters([replace(stated, prior=prior, value=prior.mean)])
    session = Session(rig, small_session.observations, "a place misstated")
    first, *rest = headline(diagnose(session, limits=Limits(most_causes=0)))
    told = re.search(r"the readings alone would put z ([\d.]+) widths of its prior", first)
    assert told is not None
    assert float(told[1]) == pytest.approx(8.0, abs=1.5)
    assert any(sentence.startswith("Check z in the rig file") for sentence in rest)


def test_something_unknown_beside_a_name_is_said_in_words_and_panels(diagnosis):
    (named,) = diagnosis.causes
    family = Family(("room", "zero"), 0.91)
    alone = replace(named, probability=0.7, alternatives=(), p_not_in_library=0.3, family=family)
    doubtful = replace(
        diagnosis,
        verdict=Verdict.INDISTINGUISHABLE,
        findings=replace(diagnosis.findings, causes=(alone,)),
        left_open=replace(diagnosis.left_open, next_measurements=()),
    )
    what, *_, then = headline(doubtful)
    assert f"({diagnosis.label(named.cause)}, 70 %), or something not in the library (30 %)." in what
    assert what.startswith(
        "Something is wrong with the field of the room or what a sensor shows without a field (91 %): "
    )
    assert "no list holds" in then
    (answer,) = panels(doubtful).answers
    assert answer.alternatives == [("something not in the library", 0.3)]
    (sized,) = doubtful.sized_causes
    assert sized.to_json()["may_be_unknown"]


def test_one_cause_at_two_places_is_told_as_sure_as_at_the_less_sure_one(diagnosis):
    (named,) = diagnosis.causes
    sure = replace(named, probability=0.95, alternatives=(), p_not_in_library=0.05, family=None)
    less = replace(sure, cause=Cause(named.cause.name, "other"), probability=0.8, p_not_in_library=0.2)
    for causes in ((sure, less), (less, sure)):
        first = headline(replace(diagnosis, findings=replace(diagnosis.findings, causes=causes)))[0]
        assert "80 %), or something not in the library (20 %)" in first


def test_what_is_left_beside_a_name_is_told_with_its_best_description(diagnosis):
    partly = said_instead(diagnosis, {(OFFSET, WANDERS): 98, (OFFSET,): 2}, [{WANDERS: 0.8, STEPS: 0.2}])
    what, beside, *_ = headline(partly)
    assert "(sensor_offset, > 99 %)" in what
    assert beside == (
        f"What is left is best described so: {EFFECTS['zero_wanders'].words} (zero_wanders, 74 %) or "
        f"{EFFECTS['gain_steps'].words} (gain_steps, 19 %)."
    )
    record = partly.to_json()
    assert record["verdict"] == "partly_explained"
    assert record["mixture"]["unlisted"]["zero"] == pytest.approx(0.95 * 0.98)
    assert record["p_not_in_library"] == pytest.approx(0.98)


def test_a_cause_that_is_probable_and_not_stated_is_told_with_its_probability(diagnosis):
    unsure = said_instead(diagnosis, {(OFFSET, GAIN): 80, (OFFSET,): 20})
    sentences = headline(unsure)
    assert f"Not sure enough to be stated: {EFFECTS['axis_gain'].words} (axis_gain, 80 %)." in sentences
    alone = said_instead(diagnosis, {(GAIN,): 80, (): 20})
    assert headline(alone)[0].startswith(
        "Something is probably wrong (80 %), and no cause is sure enough to be stated: "
    )
    unknown = said_instead(diagnosis, {(STEPS,): 100})
    assert headline(unknown)[0].startswith("Something is wrong, and no known cause is probable: ")
    mistake = NamedCause(Cause("current_sign", "coil1"), 1.0, (), 100.0)
    beside_it = replace(unknown, findings=replace(unknown.findings, record_mistakes=(mistake,)))
    assert unexplained(beside_it).startswith(
        "Something else is wrong, and no other known cause is probable: "
    )


def test_what_fills_all_slots_may_be_many_things_or_one(diagnosis):
    asked = diagnosis.findings.answer.first
    slots = Slots(asked.slots.products, asked.slots.noise, 3)
    slots.conditional = lambda chosen, noise: np.eye(1, len(asked.dictionary.items) + 1)[
        0
    ]  # one more is sure
    answer = replace(diagnosis.findings.answer, first=replace(asked, slots=slots))
    full = replace(diagnosis, findings=replace(diagnosis.findings, answer=answer))
    full = said_instead(full, {(GAIN, HEATING, WANDERS): 100})  # without the offset, which is there
    assert full.causes == ()
    beside = headline(full)[1]
    assert beside.startswith(
        "Even 3 things wrong at once do not explain the readings: there are more, or one that no list holds and that these imitate."
    )
    assert "Most probable, but not stated: " in beside
    assert "(axis_gain, > 99 %)" in beside
    assert f"Something else acts in {Link.ZERO.words} (" in beside


def test_share_of_the_misfit_is_told_beside_a_name_and_drawn(diagnosis):
    (named,) = diagnosis.causes
    share, left = Share(0.712, (0.65, 0.8)), Share(0.288, (0.2, 0.35))
    budget = Budget(9, 2e-4, 5e-6, {named.cause: share}, Share(0.0, (0.0, 0.0)), left)
    told = replace(diagnosis, fits=replace(diagnosis.fits, budget=budget))
    assert headline(told)[0].endswith(" It accounts for 71 % of the misfit of unseen readings.")
    for value, words in ((-0.08, "none"), (1.39, "all")):
        of_value = replace(budget, causes={named.cause: Share(value, (value, value))})
        sentence = headline(replace(diagnosis, fits=replace(diagnosis.fits, budget=of_value)))[0]
        assert sentence.endswith(f" It accounts for {words} of the misfit of unseen readings.")
    in_some_orders = replace(budget, has_all_orders=False)
    sentence = headline(replace(diagnosis, fits=replace(diagnosis.fits, budget=in_some_orders)))[0]
    assert sentence.endswith(" It accounts for 65 to 80 % of the misfit of unseen readings.")
    assert told.to_json()["budget"] == budget.to_json()
    figure = next(p for p in pictures(told) if p.title == "Error budget")
    assert "200 µT rms" in figure.caption
    without = replace(diagnosis, fits=replace(diagnosis.fits, budget=None))
    assert "of the misfit" not in headline(without)[0]
    assert not [p for p in pictures(without) if p.title == "Error budget"]

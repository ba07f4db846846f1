"""Page, tables, figures and record of a report agree with the diagnosis."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import replace

import pytest

from estimator.cli.diagnose import _text
from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.headline import headline
from estimator.diagnosis.panels import panels
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements.gain import rungs
from estimator.diagnosis.statements.visible import visible_tables
from estimator.diagnosis.verdict import Verdict
from estimator.diagnosis.widening import Widening
from estimator.effects.attach import with_effect
from estimator.reporting.numbers import size_with_unit
from estimator.reporting.plots import Role
from tests.estimator.diagnosis.reported import HEATING, RADIUS, as_text
from tests.estimator.diagnosis.small_fits import OFFSET_T

pytestmark = [pytest.mark.whole, pytest.mark.usefixtures("names_are_right")]


@pytest.fixture(scope="module")
def text(diagnosis: Diagnosis) -> str:
    return as_text(diagnosis)


def test_verdict_stands_first_with_its_twin_and_says_that_the_readings_cannot_tell(text):
    twins = {"sensor_offset", "background_field"}
    found = re.search(r"\((\w+), (\d+) %\), or [^(]+ \((\w+), (\d+) %\)", text)
    assert {found[1], found[3]} == twins
    assert int(found[2]) == pytest.approx(int(found[4]), abs=12)  # by how often each was drawn
    assert re.search(r"To tell them apart, measure .* \(expected odds [\d.,a-z ]+ to 1\)", text)


def test_smallest_visible_sizes_are_told_with_their_place_and_what_absorbs_them(diagnosis):
    (table,) = visible_tables(diagnosis)
    told = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    assert "axis_gain[hall]" in told
    assert all("[" in label for label in told)
    in_json = diagnosis.to_json()["smallest_visible"]["axis_gain.x"]
    assert in_json["place"] == "hall"
    assert 0.0 <= in_json["share_absorbed"] <= 1.0
    assert in_json["hidden_in"] in diagnosis.fits.plain.posterior.coordinates.quantities


def test_twins_are_those_of_causes_of_a_typical_size_for_larger_ones_are_told_apart(diagnosis, text):
    """The Earth's field at 45 standard deviations was named apart from a zero where both were also said to look alike."""
    assert diagnosis.left_open.twins
    assert "cannot tell apart at 8 standard deviations: " in text


def test_probabilities_of_a_comparison_are_told_from_those_of_the_verdict(text):
    """They differ: a zero of a sensor was stated with 35 %, and had 99.7 % in its comparison."""
    assert "neither halves of the readings nor imitations, which count in those of the verdict" in text


def test_a_number_that_the_extension_only_loosens_is_not_said_to_have_been_wrong(diagnosis):
    """Five standard deviations off, known as well and four times less well."""
    improvement = diagnosis.improvement
    assert improvement is not None
    final = diagnosis.fits.final
    far = replace(improvement, moved_sd=dict.fromkeys(improvement.moved_sd, 5.0))
    sd = {name: diagnosis.value_sd(name) for name in far.moved_sd}
    known_sd = sd | {RADIUS: sd[RADIUS] / 4.0}
    known = {name: (float(final.values[name]) - 5.0 * known_sd[name], known_sd[name]) for name in sd}
    moved = replace(diagnosis, fits=replace(diagnosis.fits, improvement=replace(far, known_before=known)))
    assert moved.no_longer_determined == (RADIUS,)
    told = moved.to_json()
    assert told["no_longer_determined"] == [RADIUS]
    assert set(told["moved_sd"]) == set(sd) - {RADIUS}
    page = as_text(moved)
    assert re.search(r"radius [\d.]+ ± [\d.]+ [\d.]+ ± [\d.]+ mm no longer determined", page)
    assert len(re.findall(r"\+5\.0", page)) == len(sd) - 1
    assert "biased" not in page
    wrong, _, less = panels(moved).moved_words.partition(" With it, ")
    assert "radius" not in wrong
    assert less == "clearly less is known of radius."


def test_without_causes_a_correction_is_told_beside_the_rig_as_described_alone(diagnosis):
    improvement = diagnosis.improvement
    assert improvement is not None
    taken = Correction(diagnosis.fits.final, (), {}, "", diagnosis.fits.final)
    for before, n_rows in ((improvement.before, 2), (improvement.after, 3)):
        gain = replace(improvement, before=before)
        fits = replace(diagnosis.fits, correction=replace(taken, gain=gain))
        assert len(rungs(replace(diagnosis, fits=fits), improvement)) == n_rows


def test_a_report_does_not_fail_for_one_part(diagnosis, monkeypatch):
    """A sentence, a warning, a table and the figures fail; all others stand, and each that fails is told in its place."""
    monkeypatch.setattr(logging.getLogger("estimator.diagnosis.part_by_part"), "handlers", [])
    whole = headline(diagnosis)
    lacking = {
        "estimator.diagnosis.statements.causes._clear_sizes": "coil1.degree1_a_T",
        "estimator.diagnosis.headline.stand_ins": "stand ins",
        "estimator.diagnosis.statements.visible.where": "visible",
        "estimator.diagnosis.figures._explained": "explained",
    }
    for target, key in lacking.items():
        monkeypatch.setattr(target, _failing(target.rpartition(".")[2], key))
    first, second, *rest = headline(diagnosis)
    assert (first, rest) == (whole[0], whole[2:])
    assert "'how large'" in second
    assert "KeyError 'coil1.degree1_a_T'" in second
    page = as_text(diagnosis)
    for words in (
        "'stand ins'",
        "'visible tables'",
        "Improvement on readings not used for fitting",
        "Symptoms",
    ):
        assert words in page
    assert first in _text(diagnosis)
    assert len(pictures(diagnosis)) >= 3


def _failing(name: str, key: str) -> Callable[..., object]:
    def failing(*_: object) -> object:
        raise KeyError(key)

    failing.__name__ = name
    return failing


def test_size_of_the_cause_is_that_which_was_put_in(text):
    value, sd = re.search(r"\bx (−?\d+\.?\d*) ± (\d+\.?\d*)", text).groups()
    assert float(value) == pytest.approx(1e6 * OFFSET_T, abs=4.0 * float(sd))


def test_quantity_that_the_session_cannot_see_is_given_no_size(diagnosis):
    """Without a thermometer nothing determines the loss per kelvin, so 0 with no uncertainty would be wrong."""
    fit = diagnosis.fits.final
    rig = with_effect(fit.rig, HEATING, fit.observations, {})
    final = fit_rig(rig, fit.observations, {}, fit.posterior.model.rules)
    heated = replace(diagnosis, fits=replace(diagnosis.fits, final=final))
    assert set(heated.quantities(HEATING)) == {"loss_per_A2", "tau_h"}


def test_intervals_of_rig_and_cause_are_wider_by_what_is_left(diagnosis):
    cause = diagnosis.causes[0].cause
    key = next(iter(diagnosis.quantities(cause)))
    widening = Widening(diagnosis.fits.final, 9.0 * diagnosis.fits.final.covariance)
    wide = replace(diagnosis, left_open=replace(diagnosis.left_open, widening=widening))
    for known, wider in (
        (diagnosis.rig_numbers()[RADIUS], wide.rig_numbers()[RADIUS]),
        (diagnosis.quantities(cause)[key], wide.quantities(cause)[key]),
    ):
        assert wider.median == known.median
        assert wider.sd == pytest.approx(3.0 * known.sd)
        low, high = (end - known.median for end in wider.ci90)
        assert high == pytest.approx(1.645 * 3.0 * known.sd, rel=1e-3)
        assert low == pytest.approx(-high)


def test_what_is_not_sure_enough_to_be_stated_is_told_apart_from_what_was_found(diagnosis):
    (named,) = diagnosis.causes
    findings = replace(diagnosis.findings, causes=(), stand_ins=(named.cause,))
    unexplained = replace(diagnosis, findings=findings, verdict=Verdict.UNEXPLAINED)
    page = as_text(unexplained)
    label = diagnosis.label(named.cause)
    assert f"The extended rig also has {label}: fitted too, but not sure" in page
    assert f"{label} x " in page.partition("Causes that are not sure enough to be stated Their")[2]
    assert diagnosis.improvement is not None
    rms = size_with_unit(diagnosis.improvement.before.errors.vector_T, "T", 3)
    assert (
        f"the rig as described misses readings that no fit has seen by {rms} rms where the expected noise leaves "
        in page
    )
    fitted = replace(unexplained, fits=replace(unexplained.fits, improvement=None))
    rms = size_with_unit(diagnosis.fits.before.lack_of_fit.rms_T, "T", 3)
    after = size_with_unit(diagnosis.fits.after.lack_of_fit.rms_T, "T", 3)
    words = f"misses the readings that were fitted by {rms} rms, the extended rig by {after}"
    assert words in headline(fitted)[0]
    assert ", mostly in x of hall" in page
    assert "What was found" not in page
    assert f"parameter {label} (not sure)" in page.partition("Impact of each cause")[2]
    race = next(p for p in pictures(unexplained) if p.title == "Hypotheses, comparison 1").figure
    assert str(Role.STAND_IN) in [text.get_text() for text in race.legends[0].get_texts()]
    assert str(Role.NAMED) not in [text.get_text() for text in race.legends[0].get_texts()]
    assert f"rig_extended.yaml also has {label}: fitted too" in _text(unexplained)
    assert "also has" not in _text(diagnosis)


def test_a_cause_that_the_rig_has_anyway_is_not_said_to_have_been_found(diagnosis):
    known = replace(diagnosis, fits=replace(diagnosis.fits, plain=diagnosis.fits.extended))
    page = as_text(known)
    assert "Causes of the rig as described" in page
    assert "What was found" not in page
    assert "Impact of each cause" not in page
    titles = {picture.title for picture in pictures(known)}
    assert "What the extension explains" not in titles
    assert {"Residual around coil1", "Residual along the most significant covariate, before"} <= titles
    assert not any("after" in title for title in titles)  # it would be the same figure again
    (error,) = (sentence for sentence in headline(known) if "no fit has seen" in sentence)
    assert re.search(r"the rms error is [\d.]+ µT\.", error)

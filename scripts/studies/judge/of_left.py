"""Statements of `coilcal diagnose` about what no name explains: that something is wrong, where it acts, and what was fitted for it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from estimator.diagnosis.mixture.links import WORDS
from estimator.effects import EFFECTS
from estimator.model.measurement_model import nominal_tensors
from estimator.rig.rig import Cause, Rig
from scripts.studies.judge.case import DIAGNOSIS, Case
from scripts.studies.judge.handed_out import HandedOut
from scripts.studies.judge.of_calibration import BY_REPEATS, BY_RIG_FILE, expected_noise
from scripts.studies.judge.reading import Readers
from scripts.studies.judge.statements import (
    PROBABILITY,
    Statement,
    number_statement,
    probability_of,
    size_of,
    with_probability,
)
from scripts.studies.judge.truth import TrueCause, Truth
from tests.hidden.links import LINK_OF_DEPARTURE, links_of

DIAGNOSE = "diagnose"
CLEARLY_WRONG = 5.0  # sigma of the noise by which a row is off that a diagnosis has to flag
ROUGHLY = 0.05  # of an error of a fit at its mode, beside that of a calibration of the same rig
MOST = 0.5  # share of the squares beyond the noise that is most of them
LINKS = "|".join(re.escape(words) for words in WORDS.values())
sentence = Readers()


def plain_name(label: str) -> str:
    """Name of a cause without its place."""
    return label.partition("[")[0]


def mistakes_left(case: Case) -> int:
    """Rows with mistakes of no cause that are clearly off and were neither flagged nor told as outliers.

    What a cause does to rows counts as that cause.
    """
    return int(_rows_left(case).any(axis=1).sum())


def _rows_left(case: Case) -> np.ndarray:
    """Reading by axis."""
    truth, told = case.truth, case.flagged.copy()
    told[[outlier["reading"] - 1 for outlier in case.diagnosis["outliers"]]] = True
    if truth is None or truth.causes:
        return np.zeros_like(told)
    if truth.noise_T is None:
        return truth.wrong & ~told
    rig = case.as_described
    true = rig.with_values({name: value for name, value in truth.values.items() if name in rig.parameters})
    expected_T = HandedOut(true, nominal_tensors(true)).readings_T(case.observations).numpy()
    off_T = np.abs(case.observations.field_sensor_T.numpy() - expected_T)
    return truth.wrong & (off_T > CLEARLY_WRONG * truth.noise_T[:, None]) & ~told


# ------------------------------------------------------------------------------------------------------------- that something is wrong


@sentence(r"Something (?:else )?is (?:wrong|probably wrong \((?P<p>[<>\d ]+ %)\)), and (?P<unknown>.+?): ")
def something_wrong(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """False where nothing is wrong."""
    if case.truth is not None:
        why = f"hidden: {case.truth.words}"
        statement = Statement("something_wrong", DIAGNOSE, text, not case.truth.is_clean, why)
        yield with_probability(statement, probability_of(match["p"])) if match["p"] else statement


@sentence(r"no (?:other )?known cause is probable|no listed cause is probable\b")
def no_known_cause(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """That no listed cause has half the probability: counted among probabilities, and right where something acts that no list holds."""
    if case.truth is not None:
        causes = case.truth.causes
        is_known = bool(causes) and all(cause.is_known for cause in causes)
        is_true = not (case.truth.is_clean or is_known)
        statement = Statement("no_known_cause", DIAGNOSE, text, is_true, f"hidden: {case.truth.words}")
        yield with_probability(statement, 0.5)


@sentence(
    r"the rig as described misses readings that no fit has seen by (?P<missed>[\d.]+ \S*T) rms"
    rf"(?:(?: where|, no more than) (?P<by>{BY_RIG_FILE}|{BY_REPEATS}) \(?(?P<noise>[\d.]+ \S*T)\)?(?:, but not at random)?)?"
    r"(?:, mostly in (?P<axis>[xyz]) of (?P<sensor>\w+))?"
)
def misses(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """How far the rig as described misses unseen readings, beside which noise, and in which component."""
    if match["noise"]:
        yield expected_noise(
            case.plain.rig, case.without_flagged, DIAGNOSE, text, size_of(match["noise"]), match["by"]
        )
    if case.flagged.any():
        return  # what `calibrate` fitted is another model then
    values = [case.plain.errors(case.held_out).vector_T]
    missed = number_statement("missed", DIAGNOSE, text, size_of(match["missed"]), values, 3)
    # What `calibrate` fits besides, such as the room's field, the rig as described lacks: it misses as much or more then.
    has_more = case.plain.rig.effects != case.as_described.effects and size_of(match["missed"]) > values[0]
    yield replace(missed, is_true=missed.is_true or has_more or (missed.off or 0.0) < ROUGHLY)
    if match["axis"] is not None:
        share, why = _share_of(case, match["sensor"], "xyz".index(match["axis"]))
        yield Statement("mostly", DIAGNOSE, text, share > MOST, why)


def _share_of(case: Case, sensor: str, axis: int) -> tuple[float, str]:
    """Share of a component of a sensor in the squares of fitted readings beyond the noise."""
    names = [each.name for each in case.plain.rig.sensors]
    readings = case.fitted
    off_T = readings.field_sensor_T.numpy() - case.plain.readings_T(readings).numpy()
    if case.truth is not None and case.truth.noise_T is not None:
        noise_T = case.truth.noise_T[~case.without_flagged.is_validation.numpy()]
    else:
        nominal = case.plain.rig.nominal_values()
        noise_T = np.array([nominal[f"{name}.noise_T"] for name in names])[readings.sensor.numpy()]
    excess = np.square(off_T) - np.square(noise_T)[:, None]
    sums = np.stack([np.nansum(excess[readings.sensor.numpy() == i], axis=0) for i in range(len(names))])
    share = sums.clip(min=0.0) / max(sums.clip(min=0.0).sum(), 1e-300)
    return float(share[names.index(sensor), axis]), f"shares by sensor and axis {np.round(share, 2).tolist()}"


# ------------------------------------------------------------------------------------------------------------------- where it acts


@sentence(
    rf"^(?P<odds>(?:even )?odds.*?) that something acts beside what is stated; it looks like a change in (?:{LINKS})$"
)
def something_beside(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Odds that something acts beside what is named, wherever; sure ones are false where nothing does."""
    yield from _acts_at(case, text, list(WORDS.values()), probability_of(match["odds"]))


@sentence(r"(?:It|Something else) acts in (?P<links>.+ \([<>\d ]+ %\))\.")
def it_acts_in(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Where it acts, link by link, each with its probability."""
    for told in match["links"].split(", and in "):
        link, _, stated = told.rpartition(" (")
        yield from _acts_at(case, text, [link], probability_of(stated.rstrip(")")))


SIZE = r"of [\d.]+ \S+ rms, \d+ in all"  # of departures that have no degree


@sentence(r"What is left is best described so: (?P<entries>.+?)\.(?: |$)")
def best_described(case: Case, _: str, match: re.Match[str]) -> Iterator[Statement]:
    """Departures, each with its probability and perhaps another one beside it: something acts at the link of one of them."""
    for entry in match["entries"].split("; "):
        told = re.findall(rf"\((?P<label>[a-z]\w*(?:\[[\w, ]+\])?)(?: {SIZE})?, (?P<p>[<>\d ]+ %)\)", entry)
        names = [plain_name(label) for label, __ in told]
        n_sensors = len(case.plain.rig.sensors)
        links = {
            link
            for name in names
            for link in (LINK_OF_DEPARTURE.get(name), *links_of(name, n_sensors))
            if link
        }
        stated = min(1.0, sum(probability_of(p) for __, p in told))
        if links:
            yield from _acts_at(case, entry, [WORDS[link] for link in WORDS if link.value in links], stated)


def _acts_at(case: Case, text: str, links: list[str], stated: float) -> Iterator[Statement]:
    """Whether something that the verdict did not name acts at one of some links.

    Less sure than `SURE` it is no false statement by itself, and counts among the probabilities.
    """
    if case.truth is None:
        return
    keys = {link.value for link, words in WORDS.items() if words in links}
    acting = _unnamed(case, case.truth, keys)
    why = f"not named at {' or '.join(sorted(keys))}: {', '.join(acting) or 'nothing'}; hidden: {case.truth.words}"
    yield with_probability(Statement("unlisted_at", DIAGNOSE, text, bool(acting), why), stated)


def _unnamed(case: Case, truth: Truth, keys: set[str]) -> list[str]:
    """What acts at a link: hidden causes that no list holds or that the verdict names nowhere, and rows that were not flagged."""
    causes = case.diagnosis["causes"]
    named = {plain_name(each["name"]) for cause in causes for each in (cause, *cause["alternatives"])}

    def acts(cause: TrueCause) -> bool:
        is_there = bool(keys & set(links_of(cause.name, len(case.plain.rig.sensors))))
        is_there |= "record" in keys and cause.name in EFFECTS and EFFECTS[cause.name].is_record_mistake
        return is_there and not (cause.is_known and cause.name in named)

    rows = _rows_left(case)
    at_rows = {"record"} if rows.any() else set()
    at_rows |= {"mover", "current"} if rows.all(axis=1).any() else {"response"} if rows.any() else set()
    return [cause.name for cause in truth.causes if acts(cause)] + ["wrong rows"] * bool(keys & at_rows)


# --------------------------------------------------------------------------------------------------------------- what was fitted for it


@sentence(r"Fitted too, but no part of the field: (?P<told>.+?)\.(?: Intervals|$)")
def fitted_too(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Corrections of the extended rig whose removal leaves the predicted field as it is."""
    yield from _corrections(case, text, match["told"], is_field=False)


@sentence(r"Predictions are corrected, not explained, by (?P<told>[a-z]\w+_\w.+?)\.(?: Fitted| Intervals|$)")
def corrected(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Corrections of the extended rig whose removal changes the predicted field."""
    if not match["told"].startswith("causes that"):
        yield from _corrections(case, text, match["told"], is_field=True)


def _corrections(case: Case, text: str, told: str, *, is_field: bool) -> Iterator[Statement]:
    model = HandedOut.of_rig_file(case.folder / DIAGNOSIS / "rig_extended.yaml")
    for label in re.findall(r"(?:^|; )([a-z]\w*(?:\[[\w, ]+\])?)", told):
        causes = _labelled(model.rig, label)
        changes = [_changes_field(model, cause, case) for cause in causes]
        is_true = bool(causes) and all(change == is_field for change in changes)
        why = f"in rig_extended.yaml: {', '.join(c.label for c in causes) or 'not there'}; changes the field: {changes}"
        yield Statement(
            "corrected" if is_field else "fitted_too", DIAGNOSE, f"{label} in: {text}", is_true, why
        )


def _labelled(rig: Rig, label: str) -> list[Cause]:
    """Corrections of a rig by a printed label, of all places that it names; empty where one is missing."""
    name, _, places = label.partition("[")
    own = {cause.place: cause for cause in rig.acting if cause.name == name}
    asked = places.rstrip("]").split(", ") if places and places != "everywhere]" else list(own)
    return [own[place] for place in asked] if set(asked) <= set(own) else []


def _changes_field(model: HandedOut, cause: Cause, case: Case) -> bool:
    """Whether the field that a user is given at the places of the readings depends on a correction."""
    with_it = model.readings_T(case.observations)
    without = HandedOut(model.rig.without_cause(cause), model.values).readings_T(case.observations)
    return not bool(
        ((with_it - without).nan_to_num().abs() <= 1e-12 * with_it.nan_to_num().abs().max()).all()
    )


# ------------------------------------------------------------------------------------------------------------------- what is less sure


@sentence(r"(?:^|\. |^  )Not sure enough to be stated: (?P<entries>.+?)\.(?: |$)")
def not_sure(case: Case, _: str, match: re.Match[str]) -> Iterator[Statement]:
    """Listed causes with probabilities that are no facts: they count among the probabilities only."""
    for label, p in re.findall(r"\(([a-z]\w*(?:\[[\w, ]+\])?), ([<>\d ]+ %)\)", match["entries"]):
        name = plain_name(label)
        if case.truth is not None and name in EFFECTS and not EFFECTS[name].is_correction:
            is_right = case.truth.is_right(name)
            statement = Statement(
                "not_sure", DIAGNOSE, f"{label} {p}", is_right, f"hidden: {case.truth.words}"
            )
            yield replace(statement, stated=probability_of(p), aside=PROBABILITY)

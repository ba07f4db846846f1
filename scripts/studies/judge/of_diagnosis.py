"""Statements of `coilcal diagnose`: its verdict, names, sizes, errors, flags, and what it says is not there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from estimator.diagnosis import effort
from estimator.diagnosis.statements.causes import LEAST_DOUBT
from estimator.diagnosis.statements.moved import MOVED_TITLE, NO_LONGER_DETERMINED
from estimator.reporting.numbers import displays, quantity_words
from scripts.studies.judge.advice import OF_DIAGNOSE
from scripts.studies.judge.case import DIAGNOSE_TEXT, Case, axes_of, rows_of
from scripts.studies.judge.intervals import FALSE_SD, false_intervals, miss_sd
from scripts.studies.judge.of_calibration import (
    by_other_code,
    counts_of,
    coverage_statement,
    goodness,
    tension_statement,
)
from scripts.studies.judge.of_left import DIAGNOSE, ROUGHLY, mistakes_left, plain_name
from scripts.studies.judge.of_left import sentence as of_left
from scripts.studies.judge.of_shown import CLEARLY_VISIBLE
from scripts.studies.judge.of_shown import sentence as of_shown
from scripts.studies.judge.reading import Readers
from scripts.studies.judge.statements import CONDITION, SURE, Statement, number_statement, size_of
from tests.hidden.links import links_of

SURE_OF_NOTHING = 0.9  # probability from which it counts as said that nothing is wrong
RIGHT_SIGMA = 3.5  # of the noise: an outlier is farther from what was true
CLEARLY_OFF = 3.0  # sd of the plain fit by which a claimed bias is not the true one
ALMOST_ALL = 0.98  # an error that falls to more than this does not fall
WORSE = 1.5  # held-out over fitted error, beyond which a fitted one says nothing of predictions
FEWEST_COMPONENTS = 20  # from which on an rms says anything
sentence = Readers(of_left, of_shown, advice=OF_DIAGNOSE)


def judged(case: Case) -> tuple[list[Statement], list[str]]:
    """Statements of the command, of its report and of the calibration beside it, and shapes of the lines that were not judged."""
    statements, unread = sentence.read(case, case.lines(DIAGNOSE_TEXT))
    for statement in (flags, outliers, moved, numbers, handed_out):
        statements += statement(case)
    return statements, unread


# ----------------------------------------------------------------------------------------------------------------- is anything wrong


@sentence(r"^verdict: named$")
def named(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """Names that are stated as facts."""
    if case.truth is None:
        return
    for cause in case.diagnosis["causes"]:
        name = plain_name(cause["name"])
        why = f"{name} with probability {cause['probability']:.3f}; hidden: {case.truth.words}"
        has_left = name == "outliers" and bool((case.truth.wrong & ~case.flagged).any())
        is_right = has_left or case.truth.is_right(name)
        told = f"{text}: {cause['name']}"
        yield Statement("name", DIAGNOSE, told, is_right, why, stated=cause["probability"])


@sentence(r"(?:show nothing wrong|Nothing else shows)(?: \((?P<sure>[<>\d ]+ %)\))?|There is nothing to mend")
def nothing_wrong(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """That nothing is wrong is false where a flaw is clearly visible, or rows are wrong, or the rig as it is gives false intervals."""
    if case.truth is None or (match["sure"] and size_of(match["sure"]) < SURE_OF_NOTHING):
        return
    visible = [c for c in case.truth.causes if c.sigma is None or c.sigma >= CLEARLY_VISIBLE]
    wrong = mistakes_left(case)
    excluded = false_intervals(case.plain, case.truth) if "mend" in text else {}
    is_true = not (visible or wrong or excluded)
    why = "; ".join([f"hidden: {case.truth.words}", f"wrong rows left: {wrong}", *excluded.values()])
    stated = size_of(match["sure"]) if match["sure"] else None
    yield Statement("nothing_wrong", DIAGNOSE, text, is_true, why, stated=stated)


@sentence(r"would have shown, for example, (?P<what>.+)\.$")
def would_have_shown(case: Case, _: str, match: re.Match[str]) -> Iterator[Statement]:
    """A size from which on a cause would have shown, where that cause is hidden and larger."""
    for item in match["what"].split(", "):
        label, _, size = item.partition(" from ")
        name, _, quantity = label.partition(" ")
        hidden = case.truth.cause(plain_name(name)) if case.truth is not None else None
        sizes = {quantity_words(k): v for k, v in hidden.quantities.items()} if hidden is not None else {}
        if case.truth is not None and size:
            true = sizes.get(quantity, 0.0)
            why = f"hidden: {case.truth.words}; {quantity} of {name} is {true:.3g}"
            yield Statement("would_have_shown", DIAGNOSE, item, abs(true) <= size_of(size), why)


@sentence(r"it is only (?P<nothing>[<>\d ]+ %) probable that nothing is wrong")
def doubts(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Doubts that are nearly certain."""
    if case.truth is not None:
        p = size_of(match["nothing"])
        is_true = not (case.truth.is_clean and p < 1.0 - SURE)
        yield Statement("doubts", DIAGNOSE, text, is_true, f"hidden: {case.truth.words}")


@sentence(r"^verdict: partly_explained$")
def partly_named(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """Causes that are stated beside something else, each with what it may be instead: one of these is there.

    Of a doubtful one its family is told first, and something is there that acts at its links.
    """
    if case.truth is None:
        return
    for cause in case.diagnosis["causes"]:
        names = [plain_name(one["name"]) for one in (cause, *cause["alternatives"])]
        is_true = any(case.truth.is_right(name) for name in names)
        if cause.get("family") and cause["p_not_in_library"] >= LEAST_DOUBT:
            n_sensors = len(case.plain.rig.sensors)
            links = {link for hidden in case.truth.causes for link in links_of(hidden.name, n_sensors)}
            is_true = is_true or bool(links & set(cause["family"]["links"]))
        why = f"one of {', '.join(names)}; hidden: {case.truth.words}"
        stated = sum(each["probability"] for each in (cause, *cause["alternatives"]))
        yield Statement("name", DIAGNOSE, f"{text}: {cause['name']}", is_true, why, stated=stated)


# ---------------------------------------------------------------------------------------------------------------- names and their sizes


@sentence(
    r"^ *(?P<label>[a-z]\w*(?:\[\w+\])?) \((?P<p>[<>\d ]+ %)\).*not in the library \((?P<unknown>[<>\d ]+ %)\)$"
)
def cause_probability(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """What a cause may be, with probabilities: false where the truth was given less than one per cent."""
    entry = next((c for c in case.diagnosis["causes"] if c["name"] == match["label"]), None)
    if case.truth is None or entry is None:
        return
    members = [entry, *entry["alternatives"]]
    stated = sum(one["probability"] for one in members if case.truth.is_right(plain_name(one["name"])))
    has_unknown = any(not cause.is_known for cause in case.truth.causes)
    stated += entry.get("p_not_in_library") or 0.0 if has_unknown or not stated else 0.0
    why = f"the truth was given {stated:.2g}; hidden: {case.truth.words}"
    yield Statement("cause_probability", DIAGNOSE, text, stated >= 1.0 - SURE, why)


def numbers(case: Case) -> Iterator[Statement]:
    """Sizes of causes with right names: each 90 % interval, where the truth is known."""
    if case.truth is None:
        return
    for cause in case.diagnosis["causes"]:
        hidden = case.truth.cause(plain_name(cause["name"]))
        for key, true in (hidden.quantities if hidden is not None else {}).items():
            told = cause["parameters"].get(key)
            if told is not None and not told.get("is_of_prior"):  # else it is told to be mostly its prior
                beyond = miss_sd(true, told["median"], tuple(told["ci90"]))
                text = f"{cause['name']} {key} {told['median']:.4g} ({told['ci90'][0]:.4g} to {told['ci90'][1]:.4g})"
                why = f"true {true:.4g}, {beyond:.1f} sd off (hidden: {case.truth.words})"
                yield Statement("size", DIAGNOSE, text, beyond <= FALSE_SD, why)


# ------------------------------------------------------------------------------------------------------------------------- errors


@sentence(r"On (?P<n>\d+) readings that no fit has seen the rms error (?P<rest>.+)$")
def gain(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """The error on unseen readings: of the field that was handed out, and that it falls where that is said.

    What only these readings have may stand beside it; then the sentence tells both errors.
    """
    if case.has_open_instant:
        return
    before, after = _before_and_after(match["rest"])
    unseen = int(case.held_out.is_measured.any(dim=1).sum())
    if unseen <= effort.MOST_READINGS_FITTED:
        yield number_statement("unseen_number", DIAGNOSE, text, float(match["n"]), [float(unseen)], 9)
    errors = [model.errors(case.held_out).vector_T for model in case.by_diagnosis]
    if not errors:
        return
    alone = re.search(r"miss these readings by (?P<size>[\d.]+ \S*T)", match["rest"])
    yield _error_statement(case, text, after if alone is None else size_of(alone["size"]), errors, 3)
    if "falls from" in match["rest"] and alone is None:
        nearest = min(errors)
        plain = case.plain.errors(case.held_out).vector_T
        why = f"with the calibration {plain:.4g} T, with what was handed out {nearest:.4g} T"
        yield Statement("gain", DIAGNOSE, text, nearest < max(ALMOST_ALL * before, plain), why)


def _error_statement(case: Case, text: str, printed: float, values: list[float], digits: int) -> Statement:
    """An error on unseen readings, to its digits; roughly where no calibration was handed out that could have it."""
    statement = number_statement("unseen_error", DIAGNOSE, text, printed, values, digits)
    is_near = case.extended is None and (statement.off or 0.0) < ROUGHLY
    return replace(statement, is_true=statement.is_true or is_near)


def _before_and_after(words: str) -> tuple[float, float]:
    """The two sizes of a sentence about a gain."""
    if fall := re.search(r"from (?P<before>[^,]+?) to (?P<after>[\d.]+ \S*T)", words):
        return size_of(fall["before"]), size_of(fall["after"])
    both = re.search(r"(?P<before>[\d.]+ \S*T) before, (?P<after>[\d.]+ \S*T) after", words)
    if both is None:
        raise ValueError(f"a sentence about a gain must have two sizes; received {words!r}")
    return size_of(both["before"]), size_of(both["after"])


@sentence(
    r"^unseen readings: (?:\S+ -> )?(?P<after>\S+) uT rms of the vector; "
    r"coverage of 90 % intervals (?:[\d.]+ % -> )?(?P<ca>[\d.]+ %)"
)
def unseen(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """The last line: error and coverage of what was handed out."""
    errors = [model.errors(case.held_out) for model in case.by_diagnosis]
    values = [one.vector_T for one in errors]
    if not values or case.has_open_instant:
        return
    after_T = 1e-6 * float(match["after"])
    yield _error_statement(case, text, after_T, values, 4)
    if case.extended is not None:
        best = case.extended_summary["best"]
        yield from by_other_code(case, best, case.observations.is_validation, DIAGNOSE, text, after_T)
    if case.extended is not None and (coverage := case.extended.coverage90(case.held_out)) is not None:
        yield coverage_statement(DIAGNOSE, text, size_of(match["ca"]), coverage, errors[-1].n_components)


@sentence(
    r"the rig as described misses by (?P<before>[\d.]+ \S*T) rms, the extended rig by (?P<after>[\d.]+ \S*T)"
)
def first_sentence(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """What is quoted first of the extended rig is what it misses unseen readings by."""
    after = size_of(match["after"])
    errors = [model.errors(case.held_out) for model in case.by_diagnosis]
    unseen_T, n = min((one.component_T, one.n_components) for one in errors) if errors else (after, 0)
    why = f"unseen components are missed by {unseen_T:.3g} T rms"
    if n >= FEWEST_COMPONENTS:
        yield Statement("first_sentence", DIAGNOSE, text, unseen_T <= WORSE * after, why, unseen_T / after)


@sentence(r"^Far from what the rig file expects: ")
def far_from_prior(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """Numbers far from their priors: those of the calibration that was handed out."""
    if case.extended is None:
        return
    free = {parameter.name: parameter for parameter in case.plain.rig.free}
    shown = {show.words: name for name, show in displays(list(free)).items()}
    for one in re.finditer(
        r"(?P<words>[a-z][\w ]*?) is (?P<value>\S+)(?: \S+)? where \S+ is expected, (?P<widths>\S+) widths",
        text,
    ):
        name = shown.get(one["words"])
        draws = case.extended.flat_draws.get(name or "")
        if name is not None and draws is not None and (prior := free[name].prior) is not None:
            distance = prior.distance(float(np.median(draws)))
            yield tension_statement(DIAGNOSE, one[0], one["widths"], distance)


# ------------------------------------------------------------------------------------------------------------------- rows and numbers


def flags(case: Case) -> Iterator[Statement]:
    """Readings that are not as they were measured: each of them has to be."""
    if case.truth is None:
        return
    for flag in case.diagnosis["flagged"]:
        rows, axes = rows_of(flag), axes_of(flag)
        wrong = case.truth.wrong[rows][:, axes].any(axis=1)
        text = f"{flag['component'] or 'all'} of {flag['sensor']} {flag['words']}, in {len(rows)} readings"
        right = rows[~wrong] + 1
        why = f"{len(right)} of them are right: {right[:8].tolist()}; hidden: {case.truth.words}"
        yield Statement("flag", DIAGNOSE, text, not len(right), why)


def outliers(case: Case) -> Iterator[Statement]:
    """Components that are outliers beyond doubt."""
    truth = case.truth
    if truth is None or truth.expected_T is None or truth.noise_T is None:
        return
    measured = case.observations.field_sensor_T.numpy()
    for outlier in case.diagnosis["outliers"]:
        if outlier["probability"] > SURE:
            row, axis = outlier["reading"] - 1, "xyz".index(outlier["component"])
            off = abs(measured[row, axis] - truth.expected_T[row, axis]) / truth.noise_T[row]
            is_true = off > RIGHT_SIGMA or bool(truth.wrong[row, axis])
            text = f"{outlier['component']} in reading {outlier['reading']} is an outlier"
            why = f"{off:.1f} sigma from what was true; hidden: {truth.words}"
            yield Statement("outlier", DIAGNOSE, text, is_true, why)


def moved(case: Case) -> Iterator[Statement]:
    """Parameters that the extension moves: what was there before was biased, unless they are no longer determined."""
    rows = case.tables.get(MOVED_TITLE, [])[1:]
    if case.truth is None:
        return
    shown = {
        show.words: (name, show.factor)
        for name, show in displays([p.name for p in case.plain.rig.free]).items()
    }
    shown |= {
        s.words: (n, s.factor) for n, s in displays(list(case.truth.values)).items() if s.words not in shown
    }
    for row in (row for row in rows if row[4] != NO_LONGER_DETERMINED):
        name, factor = shown.get(row[0], ("", 1.0))
        true, moved_sd = case.truth.values.get(name), size_of(row[4])
        before, sd = (size_of(part) for part in re.split(r"\s*±\s*", row[1], maxsplit=1))
        if true is None or moved_sd == 0.0 or sd <= 0.0:
            continue
        bias_sd = (true * factor - before) / sd
        text = f"{row[0]} moved by the extension: {row[1]} -> {row[2]} {row[3]}, {row[4]} sd"
        is_true = abs(moved_sd - bias_sd) < CLEARLY_OFF or bias_sd / moved_sd > 0.5
        why = f"true {true * factor:.6g}, {bias_sd:+.1f} sd from the plain value (hidden: {case.truth.words})"
        yield Statement("biased", DIAGNOSE, text, is_true, why)


def handed_out(case: Case) -> Iterator[Statement]:
    """The calibration beside the diagnosis: its verdict, its intervals and its loop counts, which its report prints."""
    summary, model = case.extended_summary, case.extended
    if model is None:
        return
    quality: dict[str, Any] = summary["quality"]
    ambiguous = {plain_name(cause["name"]) for cause in case.diagnosis["causes"] if cause["alternatives"]}
    if quality["verdict"] == "good":
        text = f"calibration/report.html good: {' '.join(quality['reasons'])}"
        yield goodness(case, model, DIAGNOSE, text, ambiguous)
    if case.truth is None:
        return
    excluded = false_intervals(model, case.truth, ambiguous)
    why = "; ".join(excluded.values()) or "no interval excludes the truth"
    text = f"calibration of rig_extended.yaml ({case.diagnosis['verdict']}): 90 % credible intervals"
    statement = Statement(
        "extended_intervals", DIAGNOSE, text, not excluded, f"{why} (hidden: {case.truth.words})"
    )
    condition = re.search(r"[Ii]t holds only if (\S+) is what is wrong", " ".join(quality["reasons"]))
    if condition is not None and not case.truth.is_right(plain_name(condition[1])):
        statement = replace(statement, aside=CONDITION)
    yield statement
    for entry in summary["loop_counts"][:1] if quality["verdict"] == "good" else []:
        text = f"calibration/report.html {entry['coil']}: {entry['axial']} x {entry['radial']} loops"
        stated = (entry["coil"], entry["axial"], entry["radial"])
        yield from counts_of(case, summary["loop_counts"], DIAGNOSE, text, stated)

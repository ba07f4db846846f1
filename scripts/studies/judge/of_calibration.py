"""Statements of `coilcal calibrate`: its verdict, intervals, loop counts and errors."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np
from torch import Tensor

from estimator.inference.noise_of_readings import noise_rms_T, noise_words, scatter_of_sensors
from estimator.readings.observations import Observations
from estimator.reporting.numbers import displays
from estimator.rig.rig import Rig
from scripts.studies.judge.advice import OF_CALIBRATE
from scripts.studies.judge.case import CALIBRATE_TEXT, Case
from scripts.studies.judge.handed_out import HandedOut
from scripts.studies.judge.independent import missed_T
from scripts.studies.judge.intervals import false_intervals
from scripts.studies.judge.of_nominal import sentence as of_nominal
from scripts.studies.judge.reading import Readers
from scripts.studies.judge.statements import (
    CONDITION,
    LAST_DIGIT,
    SURE,
    Statement,
    agrees,
    number_statement,
    size_of,
)

CALIBRATE = "calibrate"
MOST_MISSED = 1.5  # of the noise: what held-out readings of a good model may miss by
COVERAGE_SLACK = 0.01
# Share of components that the random numbers of two hundred draws put on the other side of an end
SCATTERED_SHARE = 0.026
LUCKY_SD = 4.0
LAST_OF_A_DISTANCE = 0.1
TOLD_APART = 0.01  # of a constant's square: with more beside the currents, readings tell it from the coils
BY_RIG_FILE, BY_REPEATS = noise_words(False), noise_words(True)
sentence = Readers(of_nominal, advice=OF_CALIBRATE)


def judged(case: Case) -> tuple[list[Statement], list[str]]:
    """Statements of the command, and shapes of the lines that were not judged."""
    return sentence.read(case, case.lines(CALIBRATE_TEXT))


@sentence(r"^(good): ")
def good(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """False where an interval excludes the truth; where that is not known, where held-out readings are missed by more than noise."""
    yield goodness(case, case.plain, CALIBRATE, text)


def goodness(
    case: Case, model: HandedOut, source: str, text: str, ambiguous: Collection[str] = ()
) -> Statement:
    """Whether a calibration that calls itself good is."""
    if case.truth is not None:
        excluded = false_intervals(model, case.truth, ambiguous)
        why = "; ".join(excluded.values()) or "no interval excludes the truth"
        return Statement("good", source, text, not excluded, f"{why} (hidden: {case.truth.words})")
    held_out = case.observations.rows(case.observations.is_validation)
    noise_T = noise_rms_T(case.plain.rig, held_out, case.plain.rig.nominal_values())
    missed_T = model.errors(held_out).vector_T
    why = f"held-out readings are missed by {missed_T:.3g} T where noise leaves {noise_T:.3g}"
    return Statement("good", source, text, missed_T <= MOST_MISSED * noise_T, why)


@sentence(rf"(?P<size>[\d.]+ [mun µ]?T) where (?P<by>{BY_RIG_FILE}|{BY_REPEATS}) (?P<noise>[\d.]+ [mun µ]?T)")
def misses(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """What the model misses, and what noise leaves."""
    is_seen = not bool(case.observations.is_validation.any())
    readings = case.observations.rows(case.observations.is_validation != is_seen)
    error_T = case.plain.errors(readings).vector_T
    yield number_statement("error", CALIBRATE, text, size_of(match["size"]), [error_T], 3)
    yield expected_noise(
        case.plain.rig, case.observations, CALIBRATE, text, size_of(match["noise"]), match["by"]
    )


def expected_noise(
    rig: Rig, observations: Observations, source: str, text: str, printed_T: float, by: str
) -> Statement:
    """Noise of unseen readings, or of all where none are: that of the rig file, or what fitted readings at one place scatter."""
    judged = observations.validation if bool(observations.is_validation.any()) else observations
    scatter = scatter_of_sensors(rig, observations.calibration) if by == BY_REPEATS else {}
    noise_T = noise_rms_T(rig, judged, rig.nominal_values(), scatter)
    return number_statement("expected_noise", source, text, printed_T, [noise_T], 3)


@sentence(
    r"^(?P<role>validation|calibration): error (?P<error>\S+ uT) rms of the vector \((?P<share>[\d.]+ %) of the field\)"
    r".*coverage of 90 % intervals (?P<coverage>[\d.]+ %)"
)
def errors(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Errors of fitted or of held-out readings, and how many of their components lie in their intervals."""
    readings = case.observations.rows(case.observations.is_validation == (match["role"] == "validation"))
    errors = case.plain.errors(readings)
    yield number_statement("error", CALIBRATE, text, size_of(match["error"]), [errors.vector_T], 4)
    yield number_statement("error", CALIBRATE, text, size_of(match["share"]), [errors.relative], 3)
    if match["role"] == "validation":
        best, is_asked = case.summary["best"], case.observations.is_validation
        yield from by_other_code(case, best, is_asked, CALIBRATE, text, size_of(match["error"]))
    coverage = case.plain.coverage90(readings)
    if coverage is not None:
        yield coverage_statement(CALIBRATE, text, size_of(match["coverage"]), coverage, errors.n_components)


def by_other_code(
    case: Case, best: Mapping[str, float], is_asked: Tensor, source: str, text: str, printed_T: float
) -> Iterator[Statement]:
    """Whether a printed error is the one by a sum of loops of another library; nothing where that has not all that acts."""
    measured_T, rows = case.without_flagged.field_sensor_T.numpy(), is_asked.numpy()
    if source == CALIBRATE:
        measured_T = case.observations.field_sensor_T.numpy()
    error_T = missed_T(case.folder, best, measured_T, rows & ~np.isnan(measured_T).all(axis=1))
    if error_T is not None:
        yield number_statement("error_by_loops", source, text, printed_T, [error_T], 4)


def coverage_statement(source: str, text: str, printed: float, coverage: float, n: int) -> Statement:
    """Whether a printed coverage is that of the model which was handed out, but for random numbers."""
    slack = COVERAGE_SLACK + LUCKY_SD * math.sqrt(SCATTERED_SHARE / n)
    why = f"printed {printed:.3f}, from the files {coverage:.3f}"
    return Statement("coverage", source, text, abs(printed - coverage) <= slack, why, abs(printed - coverage))


@sentence(r"^(?P<name>\w+(?:\[\w+\])?\.[\w.]+) +(?P<median>\S+) +(?P<low>\S+) +(?P<high>\S+)  (?P<unit>\S+)")
def row(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """A row of the table: the quantiles of the draws that were handed out, to six digits."""
    draws = case.plain.flat_draws.get(match["name"])
    if draws is None:
        return
    factor = displays([match["name"]])[match["name"]].factor
    parts = {"low": 0.05, "median": 0.5, "high": 0.95}
    drawn = {part: float(np.quantile(draws, share)) * factor for part, share in parts.items()}
    is_true = all(agrees(float(match[part]), value, 6) for part, value in drawn.items())
    yield Statement("interval_as_drawn", CALIBRATE, text, is_true, f"draws: {drawn}")


@sentence(
    r"^(?P<coil>\w+): (?P<axial>\d+) x (?P<radial>\d+) loops with probability (?P<probability>[<>\d ]+ %)"
    r"(?P<condition> if nothing is wrong)?$"
)
def counts(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Whole loop counts that are stated as a fact, perhaps under the condition that nothing is wrong."""
    entry = (match["coil"], int(match["axial"]), int(match["radial"]))
    for statement in counts_of(case, case.summary["loop_counts"], CALIBRATE, text, entry):
        yield if_nothing_is_wrong(case, statement) if match["condition"] else statement


@sentence(r"numbers, intervals and probabilities hold only if nothing is\.")
def suspect(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """Intervals that are handed out under the condition that nothing is wrong."""
    if case.truth is not None:
        excluded = false_intervals(case.plain, case.truth)
        why = (
            f"{'; '.join(excluded.values()) or 'no interval excludes the truth'} (hidden: {case.truth.words})"
        )
        yield if_nothing_is_wrong(case, Statement("intervals_if", CALIBRATE, text, not excluded, why))


def if_nothing_is_wrong(case: Case, statement: Statement) -> Statement:
    """A statement under this condition: it is judged as any other where nothing is, and counted apart elsewhere."""
    is_met = case.truth is not None and case.truth.is_clean
    return statement if is_met else replace(statement, aside=CONDITION)


def counts_of(
    case: Case, entries: list[dict[str, object]], source: str, text: str, stated: tuple[str, int, int]
) -> Iterator[Statement]:
    """Whether loop counts with their probability are wrong beyond doubt."""
    for entry in entries:
        if (entry["coil"], entry["axial"], entry["radial"]) == stated and case.truth is not None:
            coil, axial, radial = stated
            names = [f"{coil}.{way}_loops" for way in ("axial", "radial")]
            true = [case.truth.values.get(n, case.plain.rig.parameters[n].value) for n in names]
            is_right = true == [axial, radial]
            p = float(str(entry["probability"]))
            why = f"true {true}, stated {axial} x {radial} with probability {p:.4f}"
            yield Statement("loop_counts", source, text, is_right or p <= SURE, why)


@sentence(r"^(?P<name>\S+) lies (?P<distance>\S+) prior standard deviations from its prior's centre")
def tension(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """How far a number lies from its prior, and that either the prior or the model is wrong."""
    parameter = case.plain.rig.parameters[match["name"]]
    if parameter.prior is None or match["name"] not in case.plain.flat_draws:
        return
    distance = parameter.prior.distance(float(np.median(case.plain.flat_draws[match["name"]])))
    yield tension_statement(CALIBRATE, text, match["distance"], distance)


def tension_statement(source: str, text: str, printed: str, distance: float) -> Statement:
    """Whether a distance from a prior, in its widths, is that of the draws, to a tenth."""
    is_true = abs(size_of(printed) - distance) <= LAST_DIGIT * LAST_OF_A_DISTANCE
    return Statement("tension", source, text, is_true, f"printed {printed}, from the files {distance:.3g}")


@sentence(r"^The currents changed too little")
def too_little_change(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """That a constant is nearly a sum of multiples of the fitted readings' currents."""
    current_A = case.observations.rows(~case.observations.is_validation).current_A.numpy()
    constant = np.ones(len(current_A))
    rest = constant - current_A @ np.linalg.lstsq(current_A, constant, rcond=None)[0]
    share = float(np.mean(rest**2))
    why = f"beside the currents {share:.3g} of a constant is left"
    yield Statement("too_little_change", CALIBRATE, text, share <= TOLD_APART, why)

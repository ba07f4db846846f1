"""Statements of readings beside the rig's nominal model, before anything is fitted, and of coils without a current."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from estimator.model.measurement_model import nominal_tensors
from scripts.studies.judge.case import CALIBRATE_TEXT, Case
from scripts.studies.judge.handed_out import HandedOut
from scripts.studies.judge.reading import Readers
from scripts.studies.judge.statements import Statement, size_of

CALIBRATE = "calibrate"
FAR = 5.0  # times the median misfit: a line that is said to be far is at least as far off
NEAR = 0.03  # of a correlation, for which readings that are as far off as others may be left out
REVERSING = ("axes_swapped", "left_handed", "displacement_frame", "current_sign")
FAR_LINES = (
    r"^Lines? (?P<lines>[\d, ]+\d)(?: and (?P<more>\d+) more)?: much farther from the rig's nominal model"
)
sentence = Readers()


@sentence(FAR_LINES)
def far_lines(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """Lines of the table that are far off: each of those named is."""
    number = case.observations.line
    if number is None:
        return
    lines = [int(line) for line in match["lines"].split(", ")]
    rows = np.flatnonzero(np.isin(number.numpy(), lines))
    nominal_T, measured_T = _nominal_and_measured_T(case)
    has_field = np.linalg.norm(nominal_T, axis=1) > 0.0
    sizes_T = (np.linalg.norm(each_T[has_field], axis=1) for each_T in (measured_T, nominal_T))
    off_T = np.linalg.norm(measured_T - np.median(np.divide(*sizes_T)) * nominal_T, axis=1)
    is_far = off_T[rows] > FAR * np.median(off_T[has_field])
    is_true = len(rows) == len(lines) and bool(is_far.all())
    yield Statement("far_lines", CALIBRATE, text, is_true, f"far: {is_far.tolist()}")


@sentence(
    r"^(?:Fields|(?P<other>The other) fields) correlate with the rig's nominal model by (?P<correlation>−?-?[\d.]+) only"
)
def correlation(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """How well patterns agree, without lines that are called far, and that something may be wrong: nothing may in a clean session."""
    nominal_T, measured_T = _nominal_and_measured_T(case)
    n_far = _n_far(case) if match["other"] else 0
    near = np.linalg.norm(measured_T - nominal_T, axis=1).argsort()[: len(nominal_T) - n_far]
    true = _cosine(nominal_T[near], measured_T[near])
    is_true = abs(size_of(match["correlation"]) - true) < NEAR
    why = f"from the readings {true:.3g}, without the farthest {n_far}"
    if case.truth is not None:
        is_true, why = is_true and not case.truth.is_clean, f"{why}; hidden: {case.truth.words}"
    yield Statement("correlation", CALIBRATE, text, is_true, why)


def _n_far(case: Case) -> int:
    """Number of lines that are called far."""
    told = [re.match(FAR_LINES, line) for line in case.lines(CALIBRATE_TEXT)]
    return sum(match["lines"].count(",") + 1 + int(match["more"] or 0) for match in told if match)


@sentence(r"^Fields point against the rig's nominal model: a current or an axis may be reversed")
def against(case: Case, text: str, _: re.Match[str]) -> Iterator[Statement]:
    """False where fields point along, or nothing is hidden that reverses them."""
    along = _cosine(*_nominal_and_measured_T(case))
    is_reversed = case.truth is None or any(name in REVERSING for name in case.truth.names)
    why = f"cosine {along:.3g}; hidden: {'a measured map' if case.truth is None else case.truth.words}"
    yield Statement("against", CALIBRATE, text, along < 0.0 and is_reversed, why)


@sentence(r"^(?P<coil>\w+) carries no current in any reading")
def idle(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """That a coil is idle."""
    names = [coil.name for coil in case.plain.rig.coils]
    most_A = float(case.observations.current_A[:, names.index(match["coil"])].abs().max())
    yield Statement("idle_coil", CALIBRATE, text, most_A == 0.0, f"its largest current is {most_A:g} A")


def _nominal_and_measured_T(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Of readings with a current; other rows and components that were not measured are zero in both."""
    rig = case.as_described
    nominal_T = HandedOut(rig, nominal_tensors(rig)).readings_T(case.observations).numpy()
    measured_T = case.observations.field_sensor_T.numpy()
    has_current = (case.observations.current_A != 0.0).any(dim=1).numpy()
    is_asked = has_current[:, None] & np.isfinite(measured_T) & np.isfinite(nominal_T)
    return np.where(is_asked, nominal_T, 0.0), np.where(is_asked, measured_T, 0.0)


def _cosine(first: np.ndarray, second: np.ndarray) -> float:
    """Of the angle between two patterns."""
    return float((first * second).sum() / (np.linalg.norm(first) * np.linalg.norm(second)))

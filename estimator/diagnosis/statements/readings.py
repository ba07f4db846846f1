"""The readings themselves: those that cannot have been measured as they were recorded, and those that are probably outliers."""

from __future__ import annotations

from collections.abc import Iterator

from estimator.diagnosis.result import Diagnosis
from estimator.readings.flags import COMPONENTS, told
from estimator.reporting.numbers import size_with_unit
from estimator.reporting.page import Table

MOST_OUTLIERS = 20
OF_VALIDATION = " of the session for validation"


def flagged(diagnosis: Diagnosis) -> Iterator[str]:
    """Readings that cannot have been measured as they were recorded, and what was done with them."""
    flags, others = diagnosis.findings.flags, diagnosis.findings.judging_flags
    are_left_out = any(not flag.is_everywhere for flag in flags)
    sentences = (
        told(flags, diagnosis.sensor_names),
        "They were left out; what follows is of the others." if are_left_out else "",
        told(others, diagnosis.sensor_names, OF_VALIDATION),
        "They judge nothing." if others else "",
    )
    yield " ".join(filter(None, sentences))


def flags_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Flagged readings one by one, of the session and of another one that judges the fits."""
    findings, sensors = diagnosis.findings, diagnosis.sensor_names
    for of_what, flags in (("", findings.flags), (f",{OF_VALIDATION}", findings.judging_flags)):
        if flags:
            yield Table(
                f"Readings that are not as they were measured{of_what}",
                ["fields", "what is wrong", "number", "where"],
                [
                    [
                        flag.subject(sensors),
                        flag.words,
                        str(len(flag.readings)),
                        "" if flag.is_everywhere else flag.where(),
                    ]
                    for flag in flags
                ],
                "Readings are counted from 1 in the order of the file; diagnosis.json lists each. They were left out, but for what is "
                "wrong in all readings of a sensor. The words say what fits the other readings, not who made the mistake.",
            )


def outliers(diagnosis: Diagnosis) -> Iterator[str]:
    """How many components are probably outliers, and which is the farthest."""
    probable = diagnosis.findings.outliers
    if probable:
        far = probable[0]
        row = f"reading {far.reading + 1}" if far.line is None else f"line {far.line}"
        where = f"{COMPONENTS[far.component]} of {far.sensor} in {row}"
        few = (
            "one component is probably an outlier"
            if len(probable) == 1
            else f"{len(probable)} components are probably outliers, the farthest"
        )
        is_all = not diagnosis.causes and not diagnosis.record_mistakes
        few = f"But {few}" if is_all else few[0].upper() + few[1:]
        slip = f"; it {far.words}" if far.words else ""
        yield f"{few}: {where}, {size_with_unit(abs(far.miss_T), 'T')} off{slip}."


def outliers_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Components that are probably wrong, those that miss most first."""
    probable = diagnosis.findings.outliers
    if not probable:
        return
    n_more = len(probable) - MOST_OUTLIERS
    more = f" {n_more} more are in diagnosis.json." if n_more > 0 else ""
    yield Table(
        "Readings that are probably outliers",
        [
            "reading",
            "line",
            "component",
            "measured − predicted",
            "in standard deviations",
            "probability",
            "it",
        ],
        [
            [
                str(outlier.reading + 1),
                "" if outlier.line is None else str(outlier.line),
                f"{COMPONENTS[outlier.component]} of {outlier.sensor}",
                size_with_unit(outlier.miss_T, "T"),
                f"{outlier.miss_sd:.1f}",
                f"{outlier.probability:.3f}",
                outlier.words,
            ]
            for outlier in probable[:MOST_OUTLIERS]
        ],
        "Readings are counted from 1, lines are those of the file. Outliers count little in the fit. The probability follows from their "
        f"share and width, as fitted. The last column says which factor, or which other current, would explain one.{more}",
    )

"""Tables of a diagnosis: sizes, improvement on unseen readings, impacts, hypotheses, and what the readings can show."""

from __future__ import annotations

import math
from collections.abc import Sequence

from estimator.diagnosis import policy
from estimator.diagnosis.impact import impact_sd
from estimator.diagnosis.mixture.comparison import NOTHING, Comparison, Hypothesis, credible
from estimator.diagnosis.part_by_part import part_by_part
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.sizes import Interval
from estimator.diagnosis.validation import ValidationScores
from estimator.diagnosis.what_shows import visible_tables
from estimator.effects import EFFECTS
from estimator.readings.flags import COMPONENTS, Flag
from estimator.reporting.numbers import (
    displays,
    percent,
    quantity_words,
    size_with_unit,
    to_digit_of,
    with_sd,
)
from estimator.reporting.page import Table
from estimator.rig.rig import Cause

MOST_HYPOTHESES = 8
MOST_STEPS = 6
MOST_OUTLIERS = 20
MOST_IMPACT_COLUMNS = 6
NO_LONGER_DETERMINED = "no longer determined"


def tables(diagnosis: Diagnosis) -> list[Table]:
    """Tables below the headline: what was found, what it gains, what it moves, what to measure next."""
    parts = (_found_tables, _flags_tables, _outliers_tables, _validation_tables, _next_tables)
    return part_by_part(parts, diagnosis, _missing)


def _missing(fault: str) -> Table:
    """Stands in the place of a table that could not be made."""
    return Table("A table is missing", ["why"], [[fault]])


def _found_tables(diagnosis: Diagnosis) -> list[Table]:
    named = [cause for cause in diagnosis.fits.final.rig.effects if cause not in diagnosis.findings.stand_ins]
    return _sizes_tables(
        diagnosis,
        named,
        "What was found",
        "Quantities of the causes in the extended rig (rig_extended.yaml). A difference, such as x − z, is listed where the readings know "
        "it better than either quantity.",
    )


def _validation_tables(diagnosis: Diagnosis) -> list[Table]:
    """What is gained on unseen readings, and what the extension moves; none where no readings were kept out."""
    if diagnosis.improvement is None:
        return []
    moved = [table for table in (_moved_table(diagnosis), _impact_table(diagnosis)) if table.rows]
    return [_validation_table(diagnosis), *moved]


def _next_tables(diagnosis: Diagnosis) -> list[Table]:
    if not diagnosis.left_open.next_measurements:
        return []
    proposals = [
        [proposal.action.words, " or ".join(proposal.splits), f"{proposal.expected_log_evidence:.1f}"]
        for proposal in diagnosis.left_open.next_measurements
    ]
    return [
        Table(
            "What to measure next",
            ["readings", "tells apart", "expected log evidence"],
            proposals,
            "Expected log evidence that each adds, best first. Programmes that add less than 3 (odds of 20 to 1) are not listed.",
        )
    ]


def _sizes_tables(diagnosis: Diagnosis, causes: Sequence[Cause], title: str, caption: str) -> list[Table]:
    """A table of the quantities of some causes; none where they have no quantities."""
    rows = [
        [label, key, with_sd(p.median * f, p.sd * f), f"{to_digit_of(p.sd * f, p.ci90[0] * f)} to "
         f"{to_digit_of(p.sd * f, p.ci90[1] * f)}", unit]
        for label, key, p, f, unit in _parameters(diagnosis, causes)
    ]  # fmt: skip
    header = ["cause", "quantity", "value ± sd", "90 % credible interval", "unit"]
    return [Table(title, header, rows, caption)] if rows else []


def _flags_tables(diagnosis: Diagnosis) -> list[Table]:
    """Readings that cannot have been measured as they were recorded, of the session and of another one that judges the fits."""
    findings, words = diagnosis.findings, "that are not as they were measured"
    return [
        _flags_table(title, flags, diagnosis.sensor_names)
        for title, flags in (
            (f"Readings {words}", findings.flags),
            (f"Readings {words}, of the session for validation", findings.judging_flags),
        )
        if flags
    ]


def _flags_table(title: str, flags: Sequence[Flag], sensors: Sequence[str]) -> Table:
    rows = [
        [
            flag.subject(sensors),
            flag.words,
            str(len(flag.readings)),
            "" if flag.is_everywhere else flag.where(),
        ]
        for flag in flags
    ]
    return Table(
        title,
        ["fields", "what is wrong", "number", "where"],
        rows,
        "Readings are counted from 1 in the order of the file; diagnosis.json lists each. They were left out, but for what is wrong in all "
        "readings of a sensor. The words say what fits the other readings, not who made the mistake.",
    )


def _outliers_tables(diagnosis: Diagnosis) -> list[Table]:
    """Components that are probably wrong, those that miss most first; none where none is."""
    outliers = diagnosis.findings.outliers
    if not outliers:
        return []
    rows = [
        [
            str(outlier.reading + 1),
            f"{COMPONENTS[outlier.component]} of {outlier.sensor}",
            size_with_unit(outlier.miss_T, "T"),
            f"{outlier.miss_sd:.1f}",
            f"{outlier.probability:.3f}",
        ]
        for outlier in outliers[:MOST_OUTLIERS]
    ]
    more = (
        f" {len(outliers) - MOST_OUTLIERS} more are in diagnosis.json."
        if len(outliers) > MOST_OUTLIERS
        else ""
    )
    return [
        Table(
            "Readings that are probably outliers",
            ["reading", "component", "measured − predicted", "in standard deviations", "probability"],
            rows,
            "Readings are counted from 1 in the order of the file. Outliers count little in the fit. The probability follows from their "
            f"share and width, as fitted.{more}",
        )
    ]


def appendix(diagnosis: Diagnosis) -> list[Table]:
    """Tables below the figures: symptoms, hypotheses step by step, what stands in, and what the readings can show."""
    parts = (_symptoms_tables, _hypotheses_tables, _stand_in_tables, _limits_tables, visible_tables)
    return part_by_part(parts, diagnosis, _missing)


def _hypotheses_tables(diagnosis: Diagnosis) -> list[Table]:
    comparisons = enumerate(diagnosis.comparisons[:MOST_STEPS], start=1)
    return [_hypotheses_table(diagnosis, step, number, title) for number, (title, step) in comparisons]


def _stand_in_tables(diagnosis: Diagnosis) -> list[Table]:
    return _sizes_tables(
        diagnosis,
        diagnosis.findings.stand_ins,
        "Causes that are not sure enough to be stated",
        "Their quantities in the extended rig (rig_extended.yaml), which predicts better with them.",
    )


def _limits_tables(diagnosis: Diagnosis) -> list[Table]:
    """Corrections that could not be asked, or not to a higher degree; no table where there are none."""
    correction = diagnosis.fits.correction
    rows = [
        [label, EFFECTS[label.partition("[")[0]].words, words]
        for label, words in (correction.limits if correction is not None else {}).items()
    ]
    caption = (
        "They were asked to a lower degree or not at all, whatever they have to do with what is left. For those that want other places "
        "coilcal design --map proposes some."
    )
    title = "Corrections that other readings would allow"
    return (
        [Table(title, ["correction", "meaning", "what these readings lack"], rows, caption)] if rows else []
    )


def _symptoms_tables(diagnosis: Diagnosis) -> list[Table]:
    """Tests of the residual before and after the extension."""
    rows = [["before", sentence] for sentence in diagnosis.fits.before.sentences()]
    if diagnosis.fits.extended.rig.acting:
        rows += [["after", sentence] for sentence in diagnosis.fits.after.sentences()]
    caption = "Tests of the residual of the readings that were fitted."
    return [Table("Symptoms", ["model", "residual"], rows, caption)]


def _parameters(diagnosis: Diagnosis, causes: Sequence[Cause]) -> list[tuple[str, str, Interval, float, str]]:
    parameters = []
    for cause in causes:
        numbers = _numbers(diagnosis, cause)
        for key, p in numbers.items():
            display = displays([f"{cause.label}.{key}"])[f"{cause.label}.{key}"]
            if p.unit == "1" and abs(p.median) < 1.0:
                factor, unit = 100.0, "%"
            else:
                factor, unit = display.factor, display.unit or p.unit
            parameters.append((diagnosis.label(cause), quantity_words(key, numbers), p, factor, unit))
    return parameters


def _numbers(diagnosis: Diagnosis, cause: Cause) -> dict[str, Interval]:
    """Quantities of a cause by their keys, and last the difference of two that is known better than any of them."""
    numbers = diagnosis.quantities(cause)
    sized = next((sized_cause for sized_cause in diagnosis.sized_causes if sized_cause.cause == cause), None)
    if sized is not None and (known := sized.difference) is not None:
        numbers[f"{quantity_words(known.plus)} − {known.minus}"] = known.interval
    return numbers


def _names_first(diagnosis: Diagnosis) -> list[Cause]:
    """Causes of the extended rig, those that are not sure enough to be stated last."""
    return sorted(diagnosis.fits.final.rig.effects, key=lambda cause: cause in diagnosis.findings.stand_ins)


def _label(diagnosis: Diagnosis, cause: Cause) -> str:
    """Name of a cause, and whether it is not sure enough to be stated."""
    return diagnosis.label(cause) + (" (not sure)" if cause in diagnosis.findings.stand_ins else "")


def _validation_table(diagnosis: Diagnosis) -> Table:
    improvement = diagnosis.improvement
    assert improvement is not None
    rows = []
    for name, scores in rungs(diagnosis):
        angle = scores.errors.angular_deviation_rad
        rows.append(
            [
                name,
                size_with_unit(scores.errors.vector_T, "T", 4),
                percent(scores.errors.relative, 3),
                size_with_unit(scores.errors.max_T, "T", 4),
                f"{math.degrees(angle):.3f}°" if math.isfinite(angle) else "—",
                percent(scores.coverage50),
                percent(scores.coverage90),
                f"{scores.elpd:.1f}",
            ]
        )
    header = [
        "model",
        "vector rms",
        "of rms field",
        "largest",
        "mean angle",
        "in 50 %",
        "in 90 %",
        "elpd",
    ]
    caption = (
        f"The expected log predictive density (elpd) changes by {improvement.elpd_difference:+.1f} ± {improvement.elpd_se:.1f} "
        "(standard error over readings). The columns in 50 % and in 90 % give the share of components inside those predictive intervals; "
        "the mean angle is over readings with a current."
    )
    if (correction := diagnosis.fits.correction) is not None:
        caption += f" {correction.words(diagnosis.label)}"
    return Table("Improvement on readings not used for fitting", header, rows, caption)


def rungs(diagnosis: Diagnosis) -> list[tuple[str, ValidationScores]]:
    """Scores before and after; where something is corrected, those with the causes alone between them."""
    improvement, correction = diagnosis.improvement, diagnosis.fits.correction
    assert improvement is not None
    if correction is None or not correction.is_taken or correction.gain is None:
        return [("before", improvement.before), ("after", improvement.after)]
    with_causes = correction.gain.before
    if with_causes.errors == improvement.before.errors:  # no cause was kept
        return [("before", improvement.before), ("corrected, the rest is left", improvement.after)]
    return [
        ("before", improvement.before),
        ("explained: with the causes", with_causes),
        ("corrected too, the rest is left", improvement.after),
    ]


def _moved_table(diagnosis: Diagnosis) -> Table:
    improvement = diagnosis.improvement
    assert improvement is not None
    names = [name for name, sd in improvement.moved_sd.items() if abs(sd) > policy.MOVED_SD]
    loosened = diagnosis.no_longer_determined
    display = displays(names)
    rows = []
    for name in sorted(names, key=lambda n: (n in loosened, -abs(improvement.moved_sd[n]))):
        show = display[name]
        old, old_sd = (show.factor * number for number in improvement.known_before[name])
        moved = f"{improvement.moved_sd[name]:+.1f}".replace("-", "−")
        rows.append(
            [
                show.words,
                with_sd(old, old_sd),
                with_sd(
                    float(diagnosis.fits.final.values[name]) * show.factor,
                    diagnosis.value_sd(name) * show.factor,
                ),
                show.unit or "1",
                NO_LONGER_DETERMINED if name in loosened else moved,
            ]
        )
    return Table(
        "Parameters that the extension moves",
        ["parameter", "before", "after", "unit", "moved (sd)"],
        rows,
        "Parameters of the rig that lie elsewhere by more than one standard deviation of the plain fit. Those that the extended rig knows "
        f"clearly less well are said to be {NO_LONGER_DETERMINED}: that it puts them elsewhere does not say that they were wrong.",
    )


def _impact_table(diagnosis: Diagnosis) -> Table:
    """How far each cause pulls each parameter, as particle physicists list the pulls of systematic errors."""
    causes = _names_first(diagnosis)[:MOST_IMPACT_COLUMNS]
    impacts = {cause: impact_sd(diagnosis.fits.final, cause) for cause in causes}
    names = [p.name for p in diagnosis.rig.free if p.name in diagnosis.fits.final.posterior.coordinates.names]
    names = [n for n in names if any(abs(impacts[c].get(n, 0.0)) > policy.LISTED_IMPACT_SD for c in causes)]
    display = displays(names)
    rows = [
        [display[name].words, *(f"{impacts[c].get(name, 0.0):+.1f}".replace("-", "−") for c in causes)]
        for name in names
    ]
    return Table(
        "Impact of each cause",
        ["parameter", *(_label(diagnosis, cause) for cause in causes)],
        rows,
        "How far each parameter of the rig would move, in its standard deviations, if one cause were left out and the others stayed.",
    )


def _hypotheses_table(diagnosis: Diagnosis, comparison: Comparison, number: int, title: str) -> Table:
    """All hypotheses of a comparison."""
    rows = [
        [
            diagnosis.label_of_hypothesis(hypothesis),
            _words(hypothesis),
            _signed(hypothesis.log_bayes_factor),
            _percent(hypothesis.probability),
            _why(comparison, hypothesis),
        ]
        for i, hypothesis in enumerate(comparison.hypotheses)
        if i < MOST_HYPOTHESES or hypothesis.cause is None  # `nothing` and `unexplained` are always listed
    ]
    return Table(
        f"Hypotheses, comparison {number}: {title}",
        ["hypothesis", "meaning", "log Bayes factor", "probability", "outcome"],
        rows,
        "Log Bayes factors are against nothing wrong, beside all other causes and departures that lead, by the readings that were asked.",
    )


def _signed(value: float) -> str:
    """A number as text with one digit after the point, without a sign before zero.

    Examples:
        >>> _signed(-0.04), _signed(-2.34)
        ('0.0', '−2.3')
    """
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def _percent(share: float) -> str:
    return percent(share, 1) if share > 1e-3 else "< 0.1 %"


def _words(hypothesis: Hypothesis) -> str:
    if hypothesis.cause is not None:
        return EFFECTS[hypothesis.cause.name].words
    return "nothing wrong" if hypothesis.name == NOTHING else "a departure that no list holds"


def _why(comparison: Comparison, hypothesis: Hypothesis) -> str:
    if hypothesis.cause in comparison.taken:
        return "stated"
    if comparison.taken and hypothesis in credible(comparison.hypotheses):
        return "cannot be told apart from what was stated"
    return "" if hypothesis.cause is None else "not needed"

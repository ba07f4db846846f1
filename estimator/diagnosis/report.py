"""The HTML report of one diagnosis: verdict, causes with their sizes, validation, and all hypotheses that were considered."""

from __future__ import annotations

import math

from estimator.diagnosis import policy
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.hypotheses.step import Hypothesis, Step, shares_of
from estimator.diagnosis.result import Diagnosis, Interval
from estimator.diagnosis.validation import ValidationScores
from estimator.diagnosis.verdict import Alternative, Verdict
from estimator.effects import EFFECTS
from estimator.reporting.numbers import displays, to_digit_of, with_sd
from estimator.reporting.page import ReportPage, Table, render_report
from estimator.units import split_unit

MOST_HYPOTHESES = 8
MOST_STEPS = 6
PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def diagnosis_report(diagnosis: Diagnosis, command: str) -> str:
    """HTML of one diagnosis, self-contained.

    Args:
        diagnosis: The result of `estimator.diagnose`.
        command: Command that produced it, shown as provenance.
    """
    page = ReportPage(
        title=f"Diagnosis of {diagnosis.rig.name}",
        subtitle=diagnosis.question.source,
        verdict=_verdict(diagnosis),
        warnings=_warnings(diagnosis),
        tables=_tables(diagnosis),
        figures=pictures(diagnosis),
        appendix=_appendix(diagnosis),
        provenance={"command": command, "seed": str(diagnosis.question.seed), "rig": diagnosis.rig.hash},
    )
    return render_report(page)


def size_with_unit(value: float, unit: str) -> str:
    """A size to two digits in the unit of its order: `12 µT`, `0.17 %`.

    Examples:
        >>> size_with_unit(1.234e-5, "T"), size_with_unit(0.00171, "1"), size_with_unit(3.2e-4, "T/h")
        ('12 µT', '0.17 %', '320 µT/h')
    """
    if unit == "1":
        return f"{100.0 * value:.2g} %" if abs(value) < 1.0 else f"{value:.3g}"
    if unit.partition("/")[0] in ("T", "m", "rad", "A"):
        factor, prefix = next((p for p in PREFIXES if abs(value) >= p[0]), PREFIXES[-1])
        scaled = value / factor
        return f"{float(f'{scaled:.2g}'):g} {prefix}{unit}"
    return f"{value:.2g} {unit}"


def _verdict(diagnosis: Diagnosis) -> list[str]:
    listed = "; ".join(_names(diagnosis))
    if diagnosis.verdict is Verdict.NAMED:
        first = f"Found: {listed}."
    elif diagnosis.verdict is Verdict.INDISTINGUISHABLE:
        first = f"Found, but not distinguishable from other causes: {listed}."
    elif diagnosis.verdict is Verdict.UNEXPLAINED:
        known = f" Named causes: {listed}." if listed else ""
        first = f"Something is wrong that no known cause explains.{known}"
    else:
        first = "These readings show nothing wrong."
    sentences = [first]
    for named in diagnosis.causes:
        if named.alternatives:
            alternatives = ", or ".join(_alternative(diagnosis, other) for other in named.alternatives)
            sentences.append(
                f"Instead of {diagnosis.label(named.cause)} ({named.probability:.0%}) the cause may be {alternatives}."
            )
    if diagnosis.findings.stand_ins:
        labels = ", ".join(diagnosis.label(cause) for cause in diagnosis.findings.stand_ins)
        sentences.append(
            f"The extended rig also has {labels}: the fit needs them, but they may stand in for something unknown."
        )
    sentences += [_next(diagnosis)] if diagnosis.left_open.next_measurements else []
    remainder = diagnosis.findings.search.steps[-1].discrepancy
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        if remainder.log_bayes_factor <= 0.0:
            remainder = diagnosis.findings.search.base_discrepancy
        sentences.append(
            f"What remains unexplained looks like {remainder.family}; its rms is {remainder.rms_sigma:.2g} times the noise."
        )
    improvement = diagnosis.improvement
    if improvement is not None and diagnosis.fits.extended.rig.effects:
        sentences.append(
            f"On {len(improvement.before.log_density)} readings not used for fitting the rms error falls from "
            f"{_microtesla(improvement.before)} to {_microtesla(improvement.after)}."
            if improvement.is_significant
            else f"On {len(improvement.before.log_density)} readings not used for fitting the extension brings no significant "
            f"improvement: rms error {_microtesla(improvement.before)} before, {_microtesla(improvement.after)} after."
        )
    sentences.append("Before: " + " ".join(diagnosis.fits.before.sentences()))
    if diagnosis.fits.extended.rig.effects:
        sentences.append("After: " + " ".join(diagnosis.fits.after.sentences()))
    return sentences


def _alternative(diagnosis: Diagnosis, other: Alternative) -> str:
    """An alternative, its probability, and the expected log evidence between it and the named cause."""
    expected = other.expected_log_evidence
    words = "" if expected is None else f"; expected log evidence between the two {expected:.2g}"
    return f"{diagnosis.label(other.cause)} ({other.probability:.0%}{words})"


def _next(diagnosis: Diagnosis) -> str:
    best = diagnosis.left_open.next_measurements[0]
    return f"To tell them apart, measure {best.action.words} (expected log evidence {best.expected_log_evidence:.0f})."


def _warnings(diagnosis: Diagnosis) -> list[str]:
    warnings = []
    improvement = diagnosis.improvement
    if improvement is None:
        warnings.append("No readings were kept out of the fits, so the extension is not validated.")
    elif not policy.LEAST_COVERAGE90 < improvement.after.coverage90 < policy.MOST_COVERAGE90:
        warnings.append(
            f"The 90 % predictive intervals of the extended model contain {improvement.after.coverage90:.0%} of the components of "
            "unseen readings."
        )
    for cause in diagnosis.findings.search.dropped:
        warnings.append(
            f"{diagnosis.label(cause)} was taken at first and dropped when other causes explained the same structure."
        )
    return warnings


def _tables(diagnosis: Diagnosis) -> list[Table]:
    tables = []
    rows = [
        [label, key, with_sd(p.median * f, p.sd * f), f"{to_digit_of(p.sd * f, p.ci90[0] * f)} to "
         f"{to_digit_of(p.sd * f, p.ci90[1] * f)}", unit]
        for label, key, p, f, unit in _parameters(diagnosis)
    ]  # fmt: skip
    if rows:
        header = ["cause", "quantity", "value ± sd", "90 % credible interval", "unit"]
        tables.append(
            Table(
                "What was found",
                header,
                rows,
                "Quantities of the causes in the extended rig (rig_extended.yaml).",
            )
        )
    if diagnosis.improvement is not None:
        tables.append(_validation_table(diagnosis))
        moved = _moved_table(diagnosis)
        tables += [moved] if moved.rows else []
    if diagnosis.left_open.next_measurements:
        proposals = [
            [proposal.action.words, " or ".join(proposal.splits), f"{proposal.expected_log_evidence:.1f}"]
            for proposal in diagnosis.left_open.next_measurements
        ]
        tables.append(
            Table(
                "What to measure next",
                ["readings", "tells apart", "expected log evidence"],
                proposals,
                "Expected log evidence that each adds, best first. Programmes that add less than 3 (odds of 20 to 1) are not listed.",
            )
        )
    return tables


def _appendix(diagnosis: Diagnosis) -> list[Table]:
    comparisons = enumerate(diagnosis.comparisons[:MOST_STEPS], start=1)
    return [
        *(_hypotheses_table(diagnosis, step, number, title) for number, (title, step) in comparisons),
        _visible_table(diagnosis),
    ]


def _parameters(diagnosis: Diagnosis) -> list[tuple[str, str, Interval, float, str]]:
    parameters = []
    for cause in diagnosis.fits.final.rig.effects:
        for key, p in diagnosis.quantities(cause).items():
            display = displays([f"{cause.label}.{key}"])[f"{cause.label}.{key}"]
            if p.unit == "1" and abs(p.median) < 1.0:
                factor, unit = 100.0, "%"
            elif p.unit.startswith("T/") and not p.unit.startswith("T/m"):
                factor, unit = 1e6, f"µ{p.unit}"
            else:
                factor, unit = display.factor, display.unit or p.unit
            label = diagnosis.label(cause)
            role = " (stands in)" if cause in diagnosis.findings.stand_ins else ""
            parameters.append((label + role, key, p, factor, unit))
    return parameters


def _validation_table(diagnosis: Diagnosis) -> Table:
    improvement = diagnosis.improvement
    assert improvement is not None
    rows = []
    for name, scores in (("before", improvement.before), ("after", improvement.after)):
        angle = scores.errors.angular_deviation_rad
        rows.append(
            [
                name,
                _microtesla(scores),
                f"{scores.errors.relative:.3%}",
                f"{scores.errors.max_T * 1e6:.4g} µT",
                f"{math.degrees(angle):.3f}°" if math.isfinite(angle) else "—",
                f"{scores.coverage50:.0%}",
                f"{scores.coverage90:.0%}",
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
        "(standard error over readings). `in 50 %` and `in 90 %` give the share of components inside those predictive intervals."
    )
    return Table("Improvement on readings not used for fitting", header, rows, caption)


def _moved_table(diagnosis: Diagnosis) -> Table:
    improvement = diagnosis.improvement
    assert improvement is not None
    names = [name for name, sd in improvement.moved_sd.items() if abs(sd) > policy.MOVED_SD]
    display = displays(names)
    rows = []
    for name in sorted(names, key=lambda n: -abs(improvement.moved_sd[n])):
        show = display[name]
        old, new = (
            float(fit.values[name]) * show.factor for fit in (diagnosis.fits.plain, diagnosis.fits.final)
        )
        rows.append(
            [
                show.words,
                with_sd(old, diagnosis.fits.plain.value_sd(name) * show.factor),
                with_sd(new, diagnosis.value_sd(name) * show.factor),
                show.unit or "1",
                f"{improvement.moved_sd[name]:+.1f}".replace("-", "−"),
            ]
        )
    return Table(
        "Parameters biased in the plain model",
        ["parameter", "before", "after", "unit", "moved (sd)"],
        rows,
        "Parameters of the rig that the extension moves by more than one standard deviation of the plain fit.",
    )


def _hypotheses_table(diagnosis: Diagnosis, step: Step, number: int, title: str) -> Table:
    """All hypotheses of a step."""
    causes = [hypothesis for hypothesis in step.hypotheses if hypothesis.cause is not None]
    probability = dict(zip((hypothesis.name for hypothesis in causes), shares_of(causes), strict=True))
    rows = [
        [
            diagnosis.label_of_hypothesis(hypothesis),
            _words(hypothesis),
            _signed(hypothesis.log_bayes_factor),
            _percent(probability.get(hypothesis.name)),
            "—"
            if hypothesis.held_out is None
            else f"{_signed(hypothesis.held_out.elpd_difference)} ± {hypothesis.held_out.elpd_se:.1f}",
            _why(step, hypothesis),
        ]
        for i, hypothesis in enumerate(step.hypotheses)
        if i < MOST_HYPOTHESES or hypothesis.cause is None  # `nothing` and `unexplained` are always listed
    ]
    return Table(
        f"Hypotheses considered, step {number}: {title} taken",
        ["hypothesis", "meaning", "log Bayes factor", "among causes", "unseen blocks", "outcome"],
        rows,
        "Log Bayes factors are against nothing wrong. Unseen blocks: change in log predictive density where each block of neighbouring "
        "positions is predicted from the others, with its standard error.",
    )


def _signed(value: float) -> str:
    """To one digit, without a sign before zero.

    Examples:
        >>> _signed(-0.04), _signed(-2.34)
        ('0.0', '−2.3')
    """
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def _percent(share: float | None) -> str:
    if share is None:
        return "—"
    return f"{share:.1%}" if share > 1e-3 else "< 0.1 %"


def _words(hypothesis: Hypothesis) -> str:
    if hypothesis.cause is not None:
        return EFFECTS[hypothesis.cause.name].words
    return (
        "nothing wrong"
        if hypothesis.name == "nothing"
        else "a flexible curve, for what no known cause explains"
    )


def _why(step: Step, hypothesis: Hypothesis) -> str:
    if hypothesis.cause is not None and hypothesis.cause == step.taken:
        return "taken"
    if hypothesis in step.credible and step.taken is not None:
        return "cannot be told apart from what was taken"
    best = next((r for r in step.hypotheses if r.cause == step.taken), None)
    if hypothesis.name == "unexplained":
        return "tested again at the end"
    if best is None or step.taken is None:
        return "not needed" if hypothesis.cause is not None else ""
    if hypothesis.held_out is not None and hypothesis.held_out.is_loss:
        return "predicts unseen blocks worse"
    behind = best.log_bayes_factor - hypothesis.log_bayes_factor
    if hypothesis.name == "nothing":
        return f"explains nothing: {behind:.1f} behind"
    return f"explains less: {behind:.1f} behind" if behind > 0.0 else "tested again later"


def _visible_table(diagnosis: Diagnosis) -> Table:
    visible = [quantity for quantity in diagnosis.left_open.visible if quantity.is_visible]
    hidden = {diagnosis.label(quantity.cause) for quantity in diagnosis.left_open.visible} - {
        diagnosis.label(quantity.cause) for quantity in visible
    }
    sizes: dict[str, list[str]] = {}
    for quantity in visible:
        name = split_unit(quantity.key)[0] if quantity.unit != "T/h" else quantity.key[0]
        sizes.setdefault(diagnosis.label(quantity.cause), []).append(
            f"{name} {size_with_unit(quantity.size, quantity.unit)}"
        )
    rows = [[label, "; ".join(words)] for label, words in sizes.items()]
    twins = "; ".join(" = ".join(diagnosis.label(c) for c in group) for group in diagnosis.left_open.twins)
    caption = "Sizes that would change these readings by five standard deviations if nothing else were wrong."
    if hidden:
        caption += f" Not visible at any plausible size: {', '.join(sorted(hidden))}."
    if twins:
        caption += f" These readings cannot tell apart: {twins}."
    return Table("What these readings can show", ["cause", "smallest visible size"], rows, caption)


def _names(diagnosis: Diagnosis) -> list[str]:
    """The causes that were found, with their meaning; several places of one cause are listed together."""
    causes = [mistake.cause for mistake in diagnosis.record_mistakes]
    causes += [named.cause for named in diagnosis.causes]
    names = []
    for name in dict.fromkeys(cause.name for cause in causes):
        labels = [diagnosis.label(cause) for cause in causes if cause.name == name]
        places = ", ".join(cause.place for cause in causes if cause.name == name)
        label = labels[0] if len(labels) == 1 else f"{name}[{places}]"
        names.append(f"{label} ({EFFECTS[name].words})")
    return names


def _microtesla(scores: ValidationScores) -> str:
    return f"{scores.errors.vector_T * 1e6:.4g} µT"

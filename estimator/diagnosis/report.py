"""The page of one diagnosis: what the simulation gets wrong, which cause that has, and what is gained by knowing it."""

from __future__ import annotations

import math

from estimator.diagnosis import policy
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.hypotheses.step import Hypothesis, Step, shares_of
from estimator.diagnosis.result import Diagnosis, Interval
from estimator.diagnosis.validation import ValidationScores
from estimator.diagnosis.verdict import Alternative, Verdict
from estimator.effects import EFFECTS
from estimator.reporting.page import ReportPage, Table, render_report
from estimator.reporting.plots.style import displays, to_digit_of, with_sd
from estimator.units import split_unit

MOST_HYPOTHESES = 8
MOST_STEPS = 6
PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def diagnosis_report(diagnosis: Diagnosis, command: str) -> str:
    """HTML of one diagnosis, self-contained.

    Args:
        diagnosis: As `estimator.diagnosis.diagnose` returns it.
        command: What produced it, shown as provenance.
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
        first = f"Found, but not down to one cause: {listed}."
    elif diagnosis.verdict is Verdict.UNEXPLAINED:
        known = f" What can be named: {listed}." if listed else ""
        first = f"Something is wrong that no known cause explains.{known}"
    else:
        first = "Nothing is wrong that these readings could show."
    sentences = [first]
    for one in diagnosis.causes:
        if one.alternatives:
            others = ", or ".join(_alternative(diagnosis, other) for other in one.alternatives)
            sentences.append(
                f"{diagnosis.label(one.cause)} ({one.probability:.0%}) could as well be {others}."
            )
    if diagnosis.findings.stand_ins:
        kept = ", ".join(diagnosis.label(cause) for cause in diagnosis.findings.stand_ins)
        sentences.append(
            f"The extended rig also has {kept}: needed here, but something unknown may look like them."
        )
    sentences += [_next(diagnosis)] if diagnosis.left_open.next_measurements else []
    left = diagnosis.findings.search.steps[-1].discrepancy
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        seen = left if left.log_bayes_factor > 0.0 else diagnosis.findings.search.whole
        sentences.append(f"What is left looks like {seen.family}: {seen.rms_sigma:.2g} of the noise rms.")
    gain = diagnosis.improvement
    if gain is not None and diagnosis.fits.extended.rig.effects:
        sentences.append(
            f"On {len(gain.before.log_density)} readings kept out of all fits the error falls from "
            f"{_microtesla(gain.before)} to {_microtesla(gain.after)}."
            if gain.is_significant
            else f"On {len(gain.before.log_density)} readings kept out of all fits the extension gains nothing that is certain: "
            f"{_microtesla(gain.before)} before, {_microtesla(gain.after)} after."
        )
    sentences.append("Before: " + " ".join(diagnosis.fits.before.sentences()))
    if diagnosis.fits.extended.rig.effects:
        sentences.append("After: " + " ".join(diagnosis.fits.after.sentences()))
    return sentences


def _alternative(diagnosis: Diagnosis, other: Alternative) -> str:
    """Another name, how probable it is, and whether the readings could have told."""
    apart = other.expected_log_evidence
    why = "" if apart is None else f"; these readings tell the two apart by {apart:.2g} in log evidence"
    return f"{diagnosis.label(other.cause)} ({other.probability:.0%}{why})"


def _next(diagnosis: Diagnosis) -> str:
    best = diagnosis.left_open.next_measurements[0]
    return f"To tell them apart, measure {best.action.words} (expected log evidence {best.expected_log_evidence:.0f})."


def _warnings(diagnosis: Diagnosis) -> list[str]:
    found = []
    gain = diagnosis.improvement
    if gain is None:
        found.append("No readings were kept out of the fits, so nothing judges the gain.")
    elif not policy.LEAST_COVERAGE90 < gain.after.coverage90 < policy.MOST_COVERAGE90:
        found.append(
            f"The 90 % intervals of the extended model hold {gain.after.coverage90:.0%} of the components of unseen readings."
        )
    for cause in diagnosis.findings.search.dropped:
        found.append(
            f"{diagnosis.label(cause)} was taken at first and dropped when other causes explained what it had explained."
        )
    return found


def _tables(diagnosis: Diagnosis) -> list[Table]:
    tables = []
    rows = [
        [label, key, with_sd(p.median * f, p.sd * f), f"{to_digit_of(p.sd * f, p.ci90[0] * f)} to "
         f"{to_digit_of(p.sd * f, p.ci90[1] * f)}", unit]
        for label, key, p, f, unit in _parameters(diagnosis)
    ]  # fmt: skip
    if rows:
        header = ["cause", "quantity", "value ± sd", "90 % credible interval", "unit"]
        tables.append(Table("What was found", header, rows, "In the extended rig, rig_extended.yaml."))
    if diagnosis.improvement is not None:
        tables.append(_gain_table(diagnosis))
        moved = _moved_table(diagnosis)
        tables += [moved] if moved.rows else []
    if diagnosis.left_open.next_measurements:
        proposals = [
            [one.action.words, " or ".join(one.splits), f"{one.expected_log_evidence:.1f}"]
            for one in diagnosis.left_open.next_measurements
        ]
        tables.append(
            Table(
                "What to measure next",
                ["readings", "tells apart", "expected log evidence"],
                proposals,
                "What they add to the readings so far, the best few; 3 is 20 to 1, and what adds less is not listed.",
            )
        )
    return tables


def _appendix(diagnosis: Diagnosis) -> list[Table]:
    races = enumerate(diagnosis.comparisons[:MOST_STEPS], start=1)
    return [
        *(_hypotheses_table(diagnosis, step, number, title) for number, (title, step) in races),
        _visible_table(diagnosis),
    ]


def _parameters(diagnosis: Diagnosis) -> list[tuple[str, str, Interval, float, str]]:
    found = []
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
            found.append((label + role, key, p, factor, unit))
    return found


def _gain_table(diagnosis: Diagnosis) -> Table:
    gain = diagnosis.improvement
    assert gain is not None
    rows = []
    for name, judged in (("before", gain.before), ("after", gain.after)):
        angle = judged.errors.angular_deviation_rad
        rows.append(
            [
                name,
                _microtesla(judged),
                f"{judged.errors.relative:.3%}",
                f"{judged.errors.max_T * 1e6:.4g} µT",
                f"{math.degrees(angle):.3f}°" if math.isfinite(angle) else "—",
                f"{judged.coverage50:.0%}",
                f"{judged.coverage90:.0%}",
                f"{judged.elpd:.1f}",
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
        "log density",
    ]
    says = (
        f"Log predictive density changes by {gain.elpd_difference:+.1f} ± {gain.elpd_se:.1f} (standard error over readings). "
        "The columns `in` give the share of components inside intervals of that probability."
    )
    return Table("Improvement on readings not used for fitting", header, rows, says)


def _moved_table(diagnosis: Diagnosis) -> Table:
    gain = diagnosis.improvement
    assert gain is not None
    names = [name for name, sd in gain.moved_sd.items() if abs(sd) > policy.MOVED_SD]
    display = displays(names)
    rows = []
    for name in sorted(names, key=lambda n: -abs(gain.moved_sd[n])):
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
                f"{gain.moved_sd[name]:+.1f}".replace("-", "−"),
            ]
        )
    return Table(
        "What the plain model had bent to hide it",
        ["parameter", "before", "after", "unit", "moved (sd)"],
        rows,
        "Parameters of the rig that the extension moved by more than one standard deviation.",
    )


def _hypotheses_table(diagnosis: Diagnosis, step: Step, number: int, title: str) -> Table:
    """Who else was in the race."""
    causes = [hypothesis for hypothesis in step.hypotheses if hypothesis.cause is not None]
    share = dict(zip((hypothesis.name for hypothesis in causes), shares_of(causes), strict=True))
    rows = [
        [
            diagnosis.label_of_hypothesis(hypothesis),
            _words(hypothesis),
            _signed(hypothesis.log_bayes_factor),
            _percent(share.get(hypothesis.name)),
            "—"
            if hypothesis.held_out is None
            else f"{_signed(hypothesis.held_out.elpd_difference)} ± {hypothesis.held_out.elpd_se:.1f}",
            _why(step, hypothesis),
        ]
        for i, hypothesis in enumerate(step.hypotheses)
        if i < MOST_HYPOTHESES
        or hypothesis.cause is None  # nothing and the unexplained are always in the race
    ]
    return Table(
        f"Who was considered, step {number}: {title} taken",
        ["hypothesis", "meaning", "log evidence", "among causes", "unseen blocks", "outcome"],
        rows,
        "Unseen blocks: gain in log density where each block of places is predicted from the others; ± is its standard error.",
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
        "no flaw"
        if hypothesis.name == "nothing"
        else "a flexible curve that stands for what no cause explains"
    )


def _why(step: Step, hypothesis: Hypothesis) -> str:
    if hypothesis.cause is not None and hypothesis.cause == step.taken:
        return "taken"
    if hypothesis in step.credible and step.taken is not None:
        return "cannot be told from what was taken"
    best = next((r for r in step.hypotheses if r.cause == step.taken), None)
    if hypothesis.name == "unexplained":
        return "asked again at the end"
    if best is None or step.taken is None:
        return "not needed" if hypothesis.cause is not None else ""
    if hypothesis.held_out is not None and hypothesis.held_out.is_loss:
        return "predicts unseen places worse"
    behind = best.log_bayes_factor - hypothesis.log_bayes_factor
    if hypothesis.name == "nothing":
        return f"explains nothing: {behind:.1f} behind"
    return f"explains less: {behind:.1f} behind" if behind > 0.0 else "asked again after what was taken"


def _visible_table(diagnosis: Diagnosis) -> Table:
    visible = [one for one in diagnosis.left_open.visible if one.is_visible]
    hidden = {diagnosis.label(one.cause) for one in diagnosis.left_open.visible} - {
        diagnosis.label(o.cause) for o in visible
    }
    sizes: dict[str, list[str]] = {}
    for one in visible:
        quantity = split_unit(one.key)[0] if one.unit != "T/h" else one.key[0]
        sizes.setdefault(diagnosis.label(one.cause), []).append(
            f"{quantity} {size_with_unit(one.size, one.unit)}"
        )
    rows = [[label, "; ".join(words)] for label, words in sizes.items()]
    twins = "; ".join(" = ".join(diagnosis.label(c) for c in group) for group in diagnosis.left_open.twins)
    says = "Sizes that these readings would show at five standard deviations, were nothing else wrong."
    if hidden:
        says += f" Not visible at any likely size: {', '.join(sorted(hidden))}."
    if twins:
        says += f" Never to be told apart here: {twins}."
    return Table("What these readings can show", ["cause", "smallest visible"], rows, says)


def _names(diagnosis: Diagnosis) -> list[str]:
    """What was found, with its meaning; a kind of cause that is there in several places once."""
    causes = [fault.cause for fault in diagnosis.record_mistakes] + [one.cause for one in diagnosis.causes]
    found = []
    for name in dict.fromkeys(cause.name for cause in causes):
        labels = [diagnosis.label(cause) for cause in causes if cause.name == name]
        places = ", ".join(cause.place for cause in causes if cause.name == name)
        label = labels[0] if len(labels) == 1 else f"{name}[{places}]"
        found.append(f"{label} ({EFFECTS[name].words})")
    return found


def _microtesla(judged: ValidationScores) -> str:
    return f"{judged.errors.vector_T * 1e6:.4g} µT"

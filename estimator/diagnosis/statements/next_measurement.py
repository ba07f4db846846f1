"""What to do next: readings that tell alternatives apart or narrow an interval, a correction, or another rig file."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from estimator.diagnosis.next_readings.stops import best_to_shrink, candidate_stops
from estimator.diagnosis.panel_records import NextMeasurement
from estimator.diagnosis.result import EXTENDED_RIG, Diagnosis
from estimator.diagnosis.statements.causes import is_only_flagged
from estimator.diagnosis.statements.left import doubts, is_pulled, pulled
from estimator.diagnosis.statements.visible import hidden_words
from estimator.diagnosis.verdict import Verdict
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.readings.observations import Observations
from estimator.readings.plan import plan_text
from estimator.reporting.numbers import odds, quantity_words, size_with_unit
from estimator.reporting.page import Table
from estimator.rig.rig import Cause

MOST_PLANS = 3
N_STOPS = 20  # of a plan that shrinks an interval
LEAST_SHRINK = 0.9  # of the standard deviation: a plan that leaves more is not worth its time


def what_next(diagnosis: Diagnosis) -> Iterator[str]:
    """What to do next, in a sentence."""
    verdict, correction = diagnosis.verdict, diagnosis.fits.correction
    if diagnosis.left_open.next_measurements:
        best = diagnosis.left_open.next_measurements[0]
        yield f"To tell them apart, measure {best.action.words} (expected {odds(best.expected_log_evidence)})."
    elif verdict is Verdict.UNEXPLAINED and is_pulled(diagnosis):
        name, _ = pulled(diagnosis)
        yield f"Check {name} in the rig file; state a wider prior if such a value is possible, and diagnose again."
    elif correction is not None and correction.is_taken:
        yield correction.words(diagnosis.label)
    elif verdict.leaves_something:
        yield "Intervals are widened by what is left; look at the residual below before you rely on predictions."
    elif verdict is Verdict.NAMED and is_only_flagged(diagnosis):
        yield "Put the record right, and see what wrote it; the rig file is right as it is."
    elif verdict is Verdict.NAMED and diagnosis.record_mistakes:
        yield (
            "Put the record right and import it again, or mend the set-up and measure again; "
            f"{EXTENDED_RIG} is for readings that have the same mistake."
        )
    elif verdict is Verdict.NAMED:
        yield f"Use {EXTENDED_RIG} in place of the rig file, or mend the cause and measure again."
    elif verdict is Verdict.NOTHING_FOUND:
        yield _where_nothing_was_found(diagnosis)
    elif any(cause.may_be_unknown for cause in diagnosis.causes):
        yield (
            f"The readings leave room for something that no list holds: mend the cause, or use {EXTENDED_RIG}, and measure again. "
            "What is true stands out more clearly with more readings."
        )


def _where_nothing_was_found(diagnosis: Diagnosis) -> str:
    if doubts(diagnosis):
        return "Measure again, with more readings, before you rely on the rig file as it is."
    if hidden := hidden_words(diagnosis):
        return f"{hidden} Where nothing of that kind can be, use the rig file as it is."
    return "Nothing that these readings show asks for another rig file."


def next_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """All proposals that would tell alternatives apart."""
    proposals = diagnosis.left_open.next_measurements
    if proposals:
        yield Table(
            "What to measure next",
            ["readings", "tells apart", "expected log evidence"],
            [[p.action.words, " or ".join(p.splits), f"{p.expected_log_evidence:.1f}"] for p in proposals],
            "Expected log evidence that each adds, best first. Programmes that add less than 3 (odds of 20 to 1) are not listed.",
        )


def next_measurements(diagnosis: Diagnosis) -> list[NextMeasurement]:
    """What would tell alternatives apart; else what would shrink the interval of the first cause's clearest size."""
    proposals = diagnosis.left_open.next_measurements[:MOST_PLANS]
    told = [
        _planned(
            diagnosis,
            proposal.action.words,
            f"tells {' from '.join(proposal.splits)}: expected {odds(proposal.expected_log_evidence)}",
            proposal.action.readings,
            f"Turn {', '.join(proposal.action.turned)} first." if proposal.action.turned else "",
        )
        for proposal in proposals
    ]
    return told or list(islice(_shrinking(diagnosis), 1))


def _shrinking(diagnosis: Diagnosis) -> Iterator[NextMeasurement]:
    """For each named cause whose clearest size is free, readings that shrink its interval by enough."""
    final = diagnosis.fits.final
    for named in diagnosis.causes:
        name = _clearest(diagnosis, named.cause)
        if name is None:
            continue
        stops = candidate_stops(final.observations)
        rows, sds = best_to_shrink(final, [name], stops, N_STOPS)
        if float(sds[-1]) <= LEAST_SHRINK * float(sds[0]):
            what = f"{quantity_words(name.rpartition('.')[2])} of {diagnosis.label(named.cause)}"
            unit = final.rig.parameters[name].unit
            before, after = (size_with_unit(float(sd), unit) for sd in (sds[0], sds[-1]))
            why = f"its standard deviation falls from {before} to {after}"
            words = f"{len(rows)} readings that determine {what}"
            yield _planned(diagnosis, words, why, stops.rows(rows))


def _clearest(diagnosis: Diagnosis, cause: Cause) -> str | None:
    """The number of a cause that is farthest from zero in its standard deviations; None where no size is free."""
    final = diagnosis.fits.final
    sizes = [f"{cause.label}.{q.key}" for q in EFFECTS[cause.name].quantities(Extent()) if not q.is_shape]
    sds = {name: final.value_sd(name) for name in sizes if name in final.values}
    clear = {name: abs(float(final.values[name])) / sd for name, sd in sds.items() if sd > 0.0}
    return max(clear, key=clear.__getitem__, default=None)


def _planned(
    diagnosis: Diagnosis, words: str, why: str, readings: Observations, by_hand: str = ""
) -> NextMeasurement:
    """A proposal with the text of its plan, at the pace of the session."""
    plan = plan_text(words, diagnosis.rig, readings, readings.pace_s)
    return NextMeasurement(words, why, by_hand, plan, len(readings))

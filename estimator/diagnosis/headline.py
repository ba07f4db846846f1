"""The sentences of a diagnosis: what is wrong and what to do next, and what a reader must know before relying on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from estimator.diagnosis.part_by_part import part_by_part
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements.causes import how_large, what
from estimator.diagnosis.statements.gain import gained, validation_warnings
from estimator.diagnosis.statements.left import beside
from estimator.diagnosis.statements.next_measurement import what_next
from estimator.diagnosis.statements.priors import held_back, tension
from estimator.diagnosis.statements.readings import flagged, outliers
from estimator.rig.rig import Cause

MOST_LISTED = 6  # causes that a warning names one by one
NOT_SURE = "fitted too, but not sure enough to be stated"


def headline(diagnosis: Diagnosis) -> list[str]:
    """What is wrong and how sure that is, what it cost, and what to do next; the most important sentence first."""
    parts = (flagged, what, beside, how_large, outliers, gained, what_next, ended_early)
    return list(filter(None, part_by_part(parts, diagnosis, str)))


def warnings_of(diagnosis: Diagnosis) -> list[str]:
    """What a reader must know before relying on the diagnosis, one sentence each."""
    return part_by_part((tension, held_back, not_sampled, validation_warnings, stand_ins), diagnosis, str)


def ended_early(diagnosis: Diagnosis) -> Iterator[str]:
    """Says that not all was asked, and why."""
    if ended := diagnosis.findings.answer.ended_early:
        yield f"The diagnosis ended early, for {ended}; the same command goes on with it."


def not_sampled(diagnosis: Diagnosis) -> Iterator[str]:
    """Says that there is no calibration, and why."""
    if refusal := diagnosis.posterior_refusal:
        yield f"The extended rig was not sampled, so there is no calibration beside this report: {refusal}."


def stand_ins(diagnosis: Diagnosis) -> Iterator[str]:
    """Causes of the extended rig that are not sure enough to be stated."""
    if causes := diagnosis.findings.stand_ins:
        yield f"The extended rig also has {_listed(diagnosis, causes)}: {NOT_SURE}."


def _listed(diagnosis: Diagnosis, causes: Sequence[Cause]) -> str:
    """Causes by their labels, or, where they are many, by their kinds."""
    if len(causes) <= MOST_LISTED:
        return ", ".join(map(diagnosis.label, causes))
    kinds = Counter(cause.name for cause in causes)
    each = (name if number == 1 else f"{name} at {number} places" for name, number in kinds.items())
    return f"{len(causes)} causes ({', '.join(each)})"

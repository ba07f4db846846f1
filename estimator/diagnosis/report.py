"""The HTML report of one diagnosis: headline, causes with their sizes, validation, and all hypotheses that were considered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from estimator.diagnosis import policy
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.headline import headline, held_back, tension_words
from estimator.diagnosis.part_by_part import part_by_part
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.tables import appendix, tables
from estimator.reporting.numbers import percent
from estimator.reporting.page import ReportPage, render_report
from estimator.rig.rig import Cause

MOST_LISTED = 6  # causes that a warning names one by one


def diagnosis_report(diagnosis: Diagnosis, command: str) -> str:
    """HTML of one diagnosis, self-contained.

    Args:
        diagnosis: The result of `estimator.diagnose`.
        command: Command that produced it, shown as provenance.
    """
    figures = pictures(diagnosis)
    page = ReportPage(
        title=f"Diagnosis of {diagnosis.rig.name}",
        subtitle=diagnosis.question.source,
        verdict=headline(diagnosis),
        warnings=warnings_of(diagnosis),
        lead=figures[:1],
        tables=tables(diagnosis),
        figures=figures[1:],
        appendix=appendix(diagnosis),
        provenance={"command": command, "seed": str(diagnosis.question.seed), "rig": diagnosis.rig.hash},
    )
    return render_report(page)


def warnings_of(diagnosis: Diagnosis) -> list[str]:
    """What a reader must know before relying on the diagnosis, one sentence each."""
    parts = (_tension, held_back, _not_sampled, _validation, _stand_ins)
    return part_by_part(parts, diagnosis, lambda fault: fault)


def _tension(diagnosis: Diagnosis) -> list[str]:
    return list(filter(None, [tension_words(diagnosis)]))


def _not_sampled(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.posterior_refusal:
        return []
    return [
        f"The extended rig was not sampled, so there is no calibration beside this report: {diagnosis.posterior_refusal}."
    ]


def _validation(diagnosis: Diagnosis) -> list[str]:
    improvement = diagnosis.improvement
    if improvement is None:
        return ["No readings were kept out of the fits, so the extension is not validated."]
    if policy.LEAST_COVERAGE90 < improvement.after.coverage90 < policy.MOST_COVERAGE90:
        return []
    return [
        f"The 90 % predictive intervals of the extended model contain {percent(improvement.after.coverage90)} of the components of "
        "unseen readings."
    ]


def _stand_ins(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.findings.stand_ins:
        return []
    return [
        f"The extended rig also has {_listed(diagnosis, diagnosis.findings.stand_ins)}: it predicts better with them, but they are not "
        "sure enough to be stated."
    ]


def _listed(diagnosis: Diagnosis, causes: Sequence[Cause]) -> str:
    """Causes by their labels, or, where they are many, by their kinds."""
    if len(causes) <= MOST_LISTED:
        return ", ".join(diagnosis.label(cause) for cause in causes)
    kinds = Counter(cause.name for cause in causes)
    each = (name if number == 1 else f"{name} at {number} places" for name, number in kinds.items())
    return f"{len(causes)} causes ({', '.join(each)})"

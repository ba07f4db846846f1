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
from estimator.diagnosis.verdict import Verdict
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
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
    parts = (_tension, held_back, _not_sampled, _validation, _stand_ins, _dropped, _passed_over)
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
        f"The extended rig also has {_listed(diagnosis, diagnosis.findings.stand_ins)}: the fit needs them, but they may stand in for "
        "something unknown."
    ]


def _dropped(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.verdict is Verdict.PARTLY_EXPLAINED:  # whose causes the search has not taken
        return []
    return [
        f"{diagnosis.label(cause)} was taken at first and dropped when other causes explained the same structure."
        for cause in diagnosis.findings.search.dropped
    ]


def _passed_over(diagnosis: Diagnosis) -> list[str]:
    """Causes that led steps and were not taken, such as scatter that passes for anything that is wrong."""
    if diagnosis.verdict is Verdict.PARTLY_EXPLAINED:
        return []
    steps = diagnosis.findings.search.steps
    leads: dict[Cause, list[float]] = {}
    for step in steps:
        causes = [hypothesis for hypothesis in step.hypotheses if hypothesis.cause is not None]
        leader = max(causes, key=lambda hypothesis: hypothesis.log_bayes_factor, default=None)
        if leader is None or leader.cause is None or leader.cause in diagnosis.fits.final.rig.effects:
            continue
        taken = next((h.log_bayes_factor for h in causes if h.cause == step.taken), 0.0)
        if leader.log_bayes_factor > max(taken, 0.0) + policy.CLEAR_LOG_EVIDENCE:
            leads.setdefault(leader.cause, []).append(leader.log_bayes_factor)
    return [
        f"{diagnosis.label(cause)} ({EFFECTS[cause.name].words}) led {len(led)} of {len(steps)} steps of the search, by a log evidence of "
        f"up to {max(led):.0f}, and was not taken: {_why_not(cause)}."
        for cause, led in leads.items()
    ]


def _why_not(cause: Cause) -> str:
    effect = EFFECTS[cause.name]
    if isinstance(effect, NoiseEffect) and effect.imitates_structure:
        return "such scatter passes for anything that is wrong, so causes with a pattern come first. Look whether it is there, too"
    return (
        "it predicts blocks of places that were held out no better, or another explains more beside the rest"
    )


def _listed(diagnosis: Diagnosis, causes: Sequence[Cause]) -> str:
    """Causes by their labels, or, where they are many, by their kinds."""
    if len(causes) <= MOST_LISTED:
        return ", ".join(diagnosis.label(cause) for cause in causes)
    kinds = Counter(cause.name for cause in causes)
    each = (name if number == 1 else f"{name} at {number} places" for name, number in kinds.items())
    return f"{len(causes)} causes ({', '.join(each)})"

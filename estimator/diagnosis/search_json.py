"""The search for causes as `diagnosis.json` holds it (docs/file-formats.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from estimator.diagnosis.hypotheses.search_record import Search
from estimator.diagnosis.hypotheses.step import Hypothesis, Step
from estimator.rig.rig import Cause

Label = Callable[[Cause], str]


def search_to_json(search: Search, label: Label) -> dict[str, Any]:
    """Steps, other structures of the source and dropped causes, each cause by its label."""
    return {
        "steps": [_step(step, label) for step in search.steps],
        "source_model": _source_model(search, label),
        "dropped": [label(cause) for cause in search.dropped],
    }


def _step(step: Step, label: Label) -> dict[str, Any]:
    return {
        "taken": None if step.taken is None else label(step.taken),
        "considered": [_hypothesis(hypothesis, label) for hypothesis in step.hypotheses],
    }


def _hypothesis(hypothesis: Hypothesis, label: Label) -> dict[str, Any]:
    return {
        "name": hypothesis.name if hypothesis.cause is None else label(hypothesis.cause),
        "log_bayes_factor": hypothesis.log_bayes_factor,
        "probability": hypothesis.probability,
        "held_out": None if hypothesis.held_out is None else hypothesis.held_out.to_json(),
    }


def _source_model(search: Search, label: Label) -> dict[str, Any] | None:
    others = search.other_structures
    if others is None:
        return None
    return {
        "seems_wrong": search.source_seems_wrong,
        "pile": [label(cause) for cause in others.pile],
        "log_bayes_factor": others.log_bayes_factor,
        "asked": [
            {
                "name": label(structure.cause),
                "log_bayes_factor": structure.log_bayes_factor,
                "needed": [label(cause) for cause in structure.needed],
            }
            for structure in others.asked
        ],
    }

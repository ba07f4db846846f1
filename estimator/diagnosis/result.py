"""The verdict on a session, and how `diagnosis.json` says it (DESIGN section 5)."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from estimator.calibration.result import Calibration, write_text
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.gain import Gain
from estimator.diagnosis.hypotheses.record_mistakes import Fault
from estimator.diagnosis.hypotheses.search import Search, Stage
from estimator.diagnosis.hypotheses.step import Step
from estimator.diagnosis.next_readings.expected_evidence import Proposal
from estimator.diagnosis.next_readings.resolution import Visible
from estimator.diagnosis.structure.symptoms import Symptoms
from estimator.diagnosis.verdict import NamedCause, Verdict
from estimator.diagnosis.widening import Widening
from estimator.effects import EFFECTS
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.rig import Cause, Rig

DIAGNOSIS, EXTENDED_RIG, REPORT, CALIBRATION_FOLDER = (
    "diagnosis.json",
    "rig_extended.yaml",
    "report.html",
    "calibration",
)


def label_of(cause: Cause, rig: Rig) -> str:
    """Name of a cause; with its place where the rig has several."""
    return cause.name if len(EFFECTS[cause.name].places(rig)) < 2 else cause.label


@dataclass(frozen=True)
class Diagnosis:
    """The verdict on a session.

    Attributes:
        rig: As it was described.
        source: Where the readings come from.
        verdict: The outcome.
        faults: Mistakes of the record that were undone first.
        causes: What was named after that, in order.
        stand_ins: What the extended rig has beside them: taken, but not named, for something unknown may look like it.
        search: How it was found, step by step.
        visible: Smallest visible size of every quantity of every cause.
        twins: Groups of causes that this session could not tell apart.
        next_measurements: What would tell the alternatives apart, best first.
        plain: The rig as it was described, fitted.
        extended: The rig with what was named and what stands in for the rest, fitted to the readings of the search.
        fit: The same, fitted to many readings.
        before, after: What their residuals show.
        gain: On readings that were not used for fitting; None where there are none.
        widening: By what the intervals of the extended rig grow for what remains unexplained; None where nothing does.
        posterior: The extended rig, sampled and widened; None where that was not asked for or nothing was found.
    """

    rig: Rig
    source: str
    verdict: Verdict
    faults: tuple[Fault, ...]
    causes: tuple[NamedCause, ...]
    stand_ins: tuple[Cause, ...]
    search: Search
    visible: tuple[Visible, ...]
    twins: tuple[tuple[Cause, ...], ...]
    next_measurements: tuple[Proposal, ...]
    plain: Fit
    extended: Fit
    fit: Fit
    before: Symptoms
    after: Symptoms
    gain: Gain | None
    extended_rig_text: str
    seed: int
    widening: Widening | None
    posterior: Calibration | None = None

    def label(self, cause: Cause) -> str:
        """Name of a cause; with its place where the rig has several."""
        return label_of(cause, self.rig)

    def label_of_stage(self, stage: Stage) -> str:
        """What the search took in one go."""
        number = Counter(cause.name for cause in stage.causes)
        alone = {cause.name: self.label(cause) for cause in stage.causes}
        return " + ".join(alone[name] if n == 1 else f"{name} at {n} places" for name, n in number.items())

    @property
    def races(self) -> list[tuple[str, Step]]:
        """What was taken in one go, and how the first of each kind of it compares with all other hypotheses; the last took nothing."""
        first = [
            (self.label_of_stage(stage), self.search.step_of(cause))
            for stage in self.search.stages
            for cause in {cause.name: cause for cause in reversed(stage.causes)}.values()
        ]
        return [*first, ("nothing more", self.search.steps[-1])]

    def record(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it."""
        left = self.search.steps[-1].left
        result: dict[str, Any] = {
            "verdict": str(self.verdict),
            "causes": [*(self._fault(f) for f in self.faults), *(self._cause(c) for c in self.causes)],
            "stand_ins": [
                {"name": self.label(cause), "place": cause.place, "parameters": self.parameters(cause)}
                for cause in self.stand_ins
            ],
            "indistinguishable": [[self.label(cause) for cause in group] for group in self.twins],
            "next_measurement": [
                {
                    "action": one.action.words,
                    "splits": list(one.splits),
                    "expected_log_evidence": one.expected_log_evidence,
                }
                for one in self.next_measurements
            ],
            "smallest_visible": {
                f"{self.label(one.cause)}.{one.key}": {
                    "size": one.size if one.is_visible else None,
                    "unit": one.unit,
                }
                for one in self.visible
            },
            "signatures": {"before": self.before.record(), "after": self.after.record()},
            "unexplained": {
                "log_bayes_factor": left.log_bayes_factor,
                "looks_like": left.family,
                "rms_sigma": left.rms_sigma,
            },
            "rig_parameters": self.of_rig(),
            "widening": {} if self.widening is None else self.widening.factors,
            "steps": self._steps(),
            "dropped": [self.label(cause) for cause in self.search.dropped],
            "seed": self.seed,
        }
        if self.gain is not None:
            result["gain"] = {"before": self.gain.before.record(), "after": self.gain.after.record()}
            result["elpd_difference"], result["elpd_se"] = self.gain.elpd_difference, self.gain.elpd_se
            result["moved_sd"] = self.gain.moved_sd
        return result

    def save(self, folder: Path) -> None:
        """Write `diagnosis.json` and `rig_extended.yaml`."""
        write_text(folder / DIAGNOSIS, json.dumps(self.record(), indent=2, allow_nan=False) + "\n")
        write_text(folder / EXTENDED_RIG, self.extended_rig_text)

    def parameters(self, cause: Cause) -> dict[str, dict[str, Any]]:
        """Median, width and interval of each quantity of a cause that the session can see."""
        prefix = f"{cause.label}."
        unseen = EFFECTS[cause.name].unseen(self.fit.posterior.model.circumstances, cause.place)
        keys = [name.removeprefix(prefix) for name in self.fit.rig.parameters if name.startswith(prefix)]
        return {key: self._interval(prefix + key) for key in keys if key not in unseen}

    def of_rig(self) -> dict[str, dict[str, Any]]:
        """Median, width and interval of each free number that the rig had before."""
        return {p.name: self._interval(p.name) for p in self.rig.free if p.name in self.fit.rig.parameters}

    def value_sd(self, name: str) -> float:
        """Standard deviation of a free number of the extended rig by Laplace, with room for what remains unexplained."""
        factor = 1.0 if self.widening is None else self.widening.factors[name]
        return factor * self.fit.value_sd(name)

    def _interval(self, name: str) -> dict[str, Any]:
        """Of a number of the extended rig, sampled or by Laplace, with room for what remains unexplained."""
        parameter = self.fit.rig.parameters[name]
        sampled = {} if self.posterior is None else self.posterior.record["parameters"]
        if name in sampled:
            own = sampled[name]
            median, sd, ends = own["median"], own["sd"], own["ci90"]
        else:
            median = float(self.fit.values[name])
            sd = self.value_sd(name) if parameter.is_free else 0.0
            ends = [median - HALF_WIDTH_90 * sd, median + HALF_WIDTH_90 * sd]
        if (prior := parameter.prior) is not None:
            ends = [min(max(end, prior.lower), prior.upper) for end in ends]
        return {"median": median, "sd": sd, "ci90": ends, "unit": parameter.unit}

    def _cause(self, one: NamedCause) -> dict[str, Any]:
        return {
            "name": self.label(one.cause),
            "place": one.cause.place,
            "probability": one.probability,
            "alternatives": [
                {
                    "name": self.label(other.cause),
                    "probability": other.probability,
                    "expected_log_evidence": other.expected_log_evidence,
                }
                for other in one.alternatives
            ],
            "log_bayes_factor": one.log_bayes_factor,
            "parameters": self.parameters(one.cause),
        }

    def _fault(self, fault: Fault) -> dict[str, Any]:
        weights = torch.softmax(torch.tensor([0.0, *(value for _, value in fault.twins)]), 0).tolist()
        others = zip((cause for cause, _ in fault.twins), weights[1:], strict=True)
        return {
            "name": self.label(fault.cause),
            "place": fault.cause.place,
            "probability": weights[0],
            "alternatives": [{"name": self.label(c), "probability": p} for c, p in others],
            "log_bayes_factor": fault.log_bayes_factor,
            "parameters": self.parameters(fault.cause),
        }

    def _steps(self) -> list[dict[str, Any]]:
        return [
            {
                "taken": None if step.taken is None else self.label(step.taken),
                "considered": [
                    {
                        "name": rival.name if rival.cause is None else self.label(rival.cause),
                        "log_bayes_factor": rival.log_bayes_factor,
                        "probability": rival.probability,
                        "held_out": None if rival.held_out is None else asdict(rival.held_out),
                    }
                    for rival in step.rivals
                ],
            }
            for step in self.search.steps
        ]

"""The verdict on a session, and how `diagnosis.json` says it (docs/file-formats.md)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from estimator.calibration.result import Calibration
from estimator.diagnosis.extension import NOTE
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.gain import Gain
from estimator.diagnosis.hypotheses.record_mistakes import Fault
from estimator.diagnosis.hypotheses.search import Search, Stage
from estimator.diagnosis.hypotheses.step import Rival, Step
from estimator.diagnosis.next_readings.expected_evidence import Proposal
from estimator.diagnosis.next_readings.resolution import Visible
from estimator.diagnosis.structure.symptoms import Symptoms
from estimator.diagnosis.verdict import Alternative, NamedCause, Verdict
from estimator.diagnosis.widening import Widening
from estimator.effects import EFFECTS
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.write import rig_text
from estimator.store.files import write_text

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
class Question:
    """What was asked.

    Attributes:
        rig: As it was described.
        source: Where the readings come from.
        seed: Of the split, the thinning, the starts and the sampling.
    """

    rig: Rig
    source: str
    seed: int


@dataclass(frozen=True)
class Found:
    """What the search came to.

    Attributes:
        search: How the causes were found, step by step.
        faults: Mistakes of the record that were undone first.
        causes: What was named after that, in order.
        stand_ins: What the extended rig has beside them: taken, but not named, for something unknown may look like it.
    """

    search: Search
    faults: tuple[Fault, ...] = ()
    causes: tuple[NamedCause, ...] = ()
    stand_ins: tuple[Cause, ...] = ()


@dataclass(frozen=True)
class Fits:
    """The rig without and with what was found.

    Attributes:
        plain: The rig as it was described, fitted.
        extended: The rig with what was named and what stands in for the rest, fitted to the readings of the search.
        final: The same, fitted to many readings.
        before, after: What the residuals of `plain` and `extended` show.
        gain: On readings that were not used for fitting; None where there are none.
    """

    plain: Fit
    extended: Fit
    final: Fit
    before: Symptoms
    after: Symptoms
    gain: Gain | None = None


@dataclass(frozen=True)
class LeftOpen:
    """What these readings cannot tell.

    Attributes:
        visible: Smallest visible size of every quantity of every cause.
        twins: Groups of causes that this session could not tell apart.
        next_measurements: What would tell the alternatives apart, best first.
        widening: By what the intervals of the extended rig grow for what remains unexplained; None where nothing does.
    """

    visible: tuple[Visible, ...] = ()
    twins: tuple[tuple[Cause, ...], ...] = ()
    next_measurements: tuple[Proposal, ...] = ()
    widening: Widening | None = None


@dataclass(frozen=True)
class Interval:
    """One number of the extended rig: its median, standard deviation and 90 % credible interval."""

    median: float
    sd: float
    ci90: tuple[float, float]
    unit: str

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it."""
        return {"median": self.median, "sd": self.sd, "ci90": list(self.ci90), "unit": self.unit}


@dataclass(frozen=True)
class SizedCause:
    """A cause of the verdict, or a mistake of the record, with the sizes of its quantities.

    Attributes:
        cause: Kind and place.
        name: Of the cause; with its place where the rig has several.
        probability: Among its alternatives.
        alternatives: The others that it could be.
        alternative_names: Of these, as `name`.
        log_bayes_factor: Against nothing, when it was taken.
        quantities: By their SI keys, those that the session can see.
        is_fault: A mistake of the record.
    """

    cause: Cause
    name: str
    probability: float
    alternatives: tuple[Alternative, ...]
    alternative_names: tuple[str, ...]
    log_bayes_factor: float
    quantities: Mapping[str, Interval]
    is_fault: bool = False

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it; between mistakes of the record nothing is expected of further readings."""
        alternatives = [
            {"name": name, "probability": alternative.probability}
            | ({} if self.is_fault else {"expected_log_evidence": alternative.expected_log_evidence})
            for name, alternative in zip(self.alternative_names, self.alternatives, strict=True)
        ]
        return {
            "name": self.name,
            "place": self.cause.place,
            "probability": self.probability,
            "alternatives": alternatives,
            "log_bayes_factor": self.log_bayes_factor,
            "parameters": _to_json(self.quantities),
        }


@dataclass(frozen=True)
class Diagnosis:
    """The verdict on a session.

    Attributes:
        question: What was asked.
        verdict: The outcome.
        found: The causes, and how they were found.
        fits: The rig without and with them.
        left_open: What these readings cannot tell.
        extended_rig: The rig with what was named and what stands in for the rest, as `rig_extended.yaml` holds it.
        posterior: The extended rig, sampled and widened; None where that was not asked for or nothing was found.
    """

    question: Question
    verdict: Verdict
    found: Found
    fits: Fits
    left_open: LeftOpen
    extended_rig: Rig
    posterior: Calibration | None = None

    @property
    def rig(self) -> Rig:
        """As it was described."""
        return self.question.rig

    @property
    def causes(self) -> tuple[NamedCause, ...]:
        """What was named, in order."""
        return self.found.causes

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Mistakes of the record that were undone first."""
        return self.found.faults

    @property
    def gain(self) -> Gain | None:
        """On readings that were not used for fitting; None where there are none."""
        return self.fits.gain

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
        search = self.found.search
        first = [
            (self.label_of_stage(stage), search.step_of(cause))
            for stage in search.stages
            for cause in {cause.name: cause for cause in reversed(stage.causes)}.values()
        ]
        return [*first, ("nothing more", search.steps[-1])]

    @property
    def sized_causes(self) -> tuple[SizedCause, ...]:
        """Mistakes of the record, then what was named, with their sizes."""
        return (*map(self._sized_fault, self.faults), *map(self._sized, self.causes))

    def evidence(self) -> dict[str, float]:
        """Log Bayes factor of every hypothesis against nothing, before any cause was taken."""
        return {
            self.label_of_rival(rival): rival.log_bayes_factor for rival in self.found.search.steps[0].rivals
        }

    def label_of_rival(self, rival: Rival) -> str:
        """Name of a hypothesis: of its cause, where it has one."""
        return rival.name if rival.cause is None else self.label(rival.cause)

    def quantities(self, cause: Cause) -> dict[str, Interval]:
        """Each quantity of a cause that the session can see, by its SI key."""
        fit, prefix = self.fits.final, f"{cause.label}."
        unseen = EFFECTS[cause.name].unseen(fit.posterior.model.circumstances, cause.place)
        keys = [name.removeprefix(prefix) for name in fit.rig.parameters if name.startswith(prefix)]
        return {key: self._interval(prefix + key) for key in keys if key not in unseen}

    def rig_numbers(self) -> dict[str, Interval]:
        """Each free number that the rig had before."""
        parameters = self.fits.final.rig.parameters
        return {p.name: self._interval(p.name) for p in self.rig.free if p.name in parameters}

    def value_sd(self, name: str) -> float:
        """Standard deviation of a free number of the extended rig by Laplace, with room for what remains unexplained."""
        widening = self.left_open.widening
        return (1.0 if widening is None else widening.factors[name]) * self.fits.final.value_sd(name)

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it."""
        search, left_open, gain = self.found.search, self.left_open, self.gain
        left = search.steps[-1].left
        result: dict[str, Any] = {
            "verdict": str(self.verdict),
            "causes": [cause.to_json() for cause in self.sized_causes],
            "stand_ins": [
                {"name": self.label(c), "place": c.place, "parameters": _to_json(self.quantities(c))}
                for c in self.found.stand_ins
            ],
            "indistinguishable": [[self.label(cause) for cause in group] for group in left_open.twins],
            "next_measurement": [
                {
                    "action": proposal.action.words,
                    "splits": list(proposal.splits),
                    "expected_log_evidence": proposal.expected_log_evidence,
                }
                for proposal in left_open.next_measurements
            ],
            "smallest_visible": {
                f"{self.label(visible.cause)}.{visible.key}": {
                    "size": visible.size if visible.is_visible else None,
                    "unit": visible.unit,
                }
                for visible in left_open.visible
            },
            "signatures": {"before": self.fits.before.to_json(), "after": self.fits.after.to_json()},
            "unexplained": {
                "log_bayes_factor": left.log_bayes_factor,
                "looks_like": left.family,
                "rms_sigma": left.rms_sigma,
            },
            "rig_parameters": _to_json(self.rig_numbers()),
            "widening": {} if left_open.widening is None else left_open.widening.factors,
            "steps": [self._step_to_json(step) for step in search.steps],
            "dropped": [self.label(cause) for cause in search.dropped],
            "seed": self.question.seed,
        }
        if gain is not None:
            result["gain"] = {"before": gain.before.to_json(), "after": gain.after.to_json()}
            result["elpd_difference"], result["elpd_se"] = gain.elpd_difference, gain.elpd_se
            result["moved_sd"] = gain.moved_sd
        return result

    def save(self, folder: Path) -> None:
        """Write `diagnosis.json` and `rig_extended.yaml`."""
        write_text(folder / DIAGNOSIS, json.dumps(self.to_json(), indent=2, allow_nan=False) + "\n")
        note = NOTE if self.extended_rig.effects else ""
        write_text(folder / EXTENDED_RIG, rig_text(self.extended_rig, note))

    def _interval(self, name: str) -> Interval:
        """Of a number of the extended rig, sampled or by Laplace, with room for what remains unexplained."""
        parameter = self.fits.final.rig.parameters[name]
        sampled = {} if self.posterior is None else self.posterior.summary()["parameters"]
        if name in sampled:
            median, sd, (low, high) = (sampled[name][key] for key in ("median", "sd", "ci90"))
        else:
            median = float(self.fits.final.values[name])
            sd = self.value_sd(name) if parameter.is_free else 0.0
            low, high = median - HALF_WIDTH_90 * sd, median + HALF_WIDTH_90 * sd
        if (prior := parameter.prior) is not None:
            low, high = (min(max(end, prior.lower), prior.upper) for end in (low, high))
        return Interval(median, sd, (low, high), parameter.unit)

    def _sized(self, named: NamedCause) -> SizedCause:
        return SizedCause(
            named.cause,
            self.label(named.cause),
            named.probability,
            named.alternatives,
            tuple(self.label(alternative.cause) for alternative in named.alternatives),
            named.log_bayes_factor,
            self.quantities(named.cause),
        )

    def _sized_fault(self, fault: Fault) -> SizedCause:
        weights = torch.softmax(torch.tensor([0.0, *(value for _, value in fault.twins)]), 0).tolist()
        twins = zip((cause for cause, _ in fault.twins), weights[1:], strict=True)
        alternatives = tuple(Alternative(cause, probability, None) for cause, probability in twins)
        named = NamedCause(fault.cause, weights[0], alternatives, fault.log_bayes_factor)
        return replace(self._sized(named), is_fault=True)

    def _step_to_json(self, step: Step) -> dict[str, Any]:
        return {
            "taken": None if step.taken is None else self.label(step.taken),
            "considered": [
                {
                    "name": self.label_of_rival(rival),
                    "log_bayes_factor": rival.log_bayes_factor,
                    "probability": rival.probability,
                    "held_out": None if rival.held_out is None else asdict(rival.held_out),
                }
                for rival in step.rivals
            ],
        }


def _to_json(intervals: Mapping[str, Interval]) -> dict[str, Any]:
    return {key: interval.to_json() for key, interval in intervals.items()}

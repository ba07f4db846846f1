"""The result of a diagnosis, and its JSON form `diagnosis.json` (docs/file-formats.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from estimator.calibration.result import CALIBRATION, Calibration
from estimator.diagnosis import policy
from estimator.diagnosis.budget import Budget
from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.differences import clearest_difference
from estimator.diagnosis.extension import NOTE
from estimator.diagnosis.fit_journal import FITS
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.record_mistakes import RecordMistake
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.comparison import Comparison, Hypothesis
from estimator.diagnosis.next_readings.expected_evidence import Proposal
from estimator.diagnosis.next_readings.resolution import Visible
from estimator.diagnosis.outlying import Outlier
from estimator.diagnosis.presented import Presented
from estimator.diagnosis.sizes import Interval, SizedCause, intervals_to_json
from estimator.diagnosis.structure.pull import Pull
from estimator.diagnosis.structure.scatter import Scatter
from estimator.diagnosis.structure.symptoms import Symptoms
from estimator.diagnosis.validation import Improvement
from estimator.diagnosis.verdict import Alternative, NamedCause, Verdict
from estimator.diagnosis.widening import Widening
from estimator.effects import EFFECTS
from estimator.json_files import sealed
from estimator.readings.flags import Flag
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.write import rig_text
from estimator.store.files import write_text
from estimator.store.made import Made, holds

DIAGNOSIS, EXTENDED_RIG, REPORT, CALIBRATION_FOLDER = (
    "diagnosis.json",
    "rig_extended.yaml",
    "report.html",
    "calibration",
)
MADE = Made(
    "a diagnosis",
    r"diagnosis\.json|rig_extended\.yaml|report\.html|panels\.json|fits\.jsonl"
    rf"|calibration/(?:{CALIBRATION.files})",
    (DIAGNOSIS, EXTENDED_RIG, REPORT, CALIBRATION_FOLDER),
    lambda folder: holds(folder / DIAGNOSIS, '"verdict"') or holds(folder / FITS, '"key"'),
)


def label_of(cause: Cause, rig: Rig) -> str:
    """Name of a cause, with its place where the rig has several for it."""
    return cause.name if len(EFFECTS[cause.name].places(rig)) < 2 else cause.label


@dataclass(frozen=True)
class Question:
    """What was asked.

    Attributes:
        rig: As described.
        source: Where the readings come from.
        seed: Of the split, the thinning, the starts and the sampling.
    """

    rig: Rig
    source: str
    seed: int


@dataclass(frozen=True)
class Findings:
    """What was found.

    Attributes:
        answer: What the readings say of causes and of departures that no list holds.
        scatter: Whether they scatter otherwise than the leading causes say.
        pull: Whether the fit with these pulls a number of the rig far from its prior.
        record_mistakes: Mistakes of the record, undone before.
        causes: The named causes, surest first.
        stand_ins: Further causes of the extended rig, which are not sure enough to be stated.
        flags: Readings that cannot have been measured as they were recorded. What they hold was left out.
        judging_flags: The same of another session, which judges the fits.
        outliers: Components that are probably wrong, where the extended rig has outliers, those that miss most first.
    """

    answer: Answer
    scatter: Scatter
    pull: Pull
    record_mistakes: tuple[RecordMistake, ...] = ()
    causes: tuple[NamedCause, ...] = ()
    stand_ins: tuple[Cause, ...] = ()
    flags: tuple[Flag, ...] = ()
    judging_flags: tuple[Flag, ...] = ()
    outliers: tuple[Outlier, ...] = ()


@dataclass(frozen=True)
class Fits:
    """Fits of the rig without and with the causes that were found.

    Attributes:
        plain: The rig as described.
        extended: The extended rig, fitted to the readings of the search.
        final: The extended rig, fitted to more readings.
        before, after: Symptoms in the residuals of `plain` and `extended`.
        improvement: Of the predictions of unseen readings; None where there are none.
        correction: Of what no cause explains; its terms are in `extended` and `final`. None where nothing is unexplained.
        budget: Shares of the error on unseen readings; None where there are none, or nothing was found.
    """

    plain: Fit
    extended: Fit
    final: Fit
    before: Symptoms
    after: Symptoms
    improvement: Improvement | None = None
    correction: Correction | None = None
    budget: Budget | None = None


@dataclass(frozen=True)
class LeftOpen:
    """What these readings cannot tell.

    Attributes:
        visible: Smallest visible size of every quantity of every cause.
        twins: Groups of causes that this session cannot tell apart.
        next_measurements: Proposals that would tell the alternatives apart, best first.
        widening: Growth of the intervals of the extended rig; None where nothing remains unexplained.
    """

    visible: tuple[Visible, ...] = ()
    twins: tuple[tuple[Cause, ...], ...] = ()
    next_measurements: tuple[Proposal, ...] = ()
    widening: Widening | None = None


@dataclass(frozen=True, repr=False)
class Diagnosis(Presented):
    """The result of a diagnosis.

    Attributes:
        question: What was asked.
        verdict: The outcome.
        findings: The causes, and the search that found them.
        fits: The rig without and with the causes.
        left_open: What these readings cannot tell.
        extended_rig: The rig with the named causes and the stand-ins, as `rig_extended.yaml` holds it.
        posterior: The extended rig, sampled and widened; None where that was not asked for or nothing was found.
        posterior_refusal: Why the extended rig could not be sampled though that was asked for; empty where nothing stood in the way.
    """

    question: Question
    verdict: Verdict
    findings: Findings
    fits: Fits
    left_open: LeftOpen
    extended_rig: Rig
    posterior: Calibration | None = None
    posterior_refusal: str = ""

    @property
    def rig(self) -> Rig:
        """The rig as described."""
        return self.question.rig

    @property
    def causes(self) -> tuple[NamedCause, ...]:
        """The named causes, in order."""
        return self.findings.causes

    @property
    def record_mistakes(self) -> tuple[RecordMistake, ...]:
        """Mistakes of the record, undone before the search."""
        return self.findings.record_mistakes

    @property
    def is_record_wrong(self) -> bool:
        """Whether there are mistakes of the record, or readings that are not as they were measured."""
        return bool(self.record_mistakes or self.findings.flags)

    @property
    def sensor_names(self) -> list[str]:
        """Names of the rig's sensors, in order."""
        return [sensor.name for sensor in self.rig.sensors]

    @property
    def improvement(self) -> Improvement | None:
        """Improvement of the predictions of unseen readings; None where there are none."""
        return self.fits.improvement

    def label(self, cause: Cause) -> str:
        """Name of a cause, with its place where the rig has several for it."""
        return label_of(cause, self.rig)

    @property
    def comparisons(self) -> list[tuple[str, Comparison]]:
        """In the place of each stated cause all hypotheses, with the names of what was stated; last, beside all that leads."""
        return [
            (" or ".join(map(self.label, comparison.taken)) or "nothing more", comparison)
            for comparison in self.findings.answer.comparisons
        ]

    @property
    def sized_causes(self) -> tuple[SizedCause, ...]:
        """Mistakes of the record, then the named causes, with their sizes."""
        return (*map(self._sized_mistake, self.record_mistakes), *map(self._sized, self.causes))

    @property
    def p_not_in_library(self) -> float:
        """Probability that something is there which no list holds: beside the named causes, or instead of one."""
        findings = self.findings
        left = max(findings.answer.p_unlisted, findings.scatter.probability, findings.pull.probability)
        return max(left, *(cause.p_not_in_library for cause in self.causes), 0.0)

    def evidence(self) -> dict[str, float]:
        """Log Bayes factor of every hypothesis against nothing, each alone."""
        return {
            self.label_of_hypothesis(hypothesis): hypothesis.log_bayes_factor
            for hypothesis in self.findings.answer.alone.hypotheses
        }

    def label_of_hypothesis(self, hypothesis: Hypothesis) -> str:
        """Name of the hypothesis' cause; else `nothing` or `unexplained`."""
        return hypothesis.name if hypothesis.cause is None else self.label(hypothesis.cause)

    def quantities(self, cause: Cause) -> dict[str, Interval]:
        """Quantities of a cause that the session can see, by SI key."""
        fit, prefix = self.fits.final, f"{cause.label}."
        unseen = EFFECTS[cause.name].unseen(fit.posterior.model.circumstances, cause.place)
        keys = [name.removeprefix(prefix) for name in fit.rig.parameters if name.startswith(prefix)]
        return {key: self._interval(prefix + key) for key in keys if key not in unseen}

    def rig_numbers(self) -> dict[str, Interval]:
        """Free parameters of the rig as described."""
        parameters = self.fits.final.rig.parameters
        return {p.name: self._interval(p.name) for p in self.rig.free if p.name in parameters}

    def value_sd(self, name: str) -> float:
        """Standard deviation of a free parameter of the extended rig by Laplace, widened by what remains unexplained."""
        widening = self.left_open.widening
        return (1.0 if widening is None else widening.factors[name]) * self.fits.final.value_sd(name)

    @property
    def no_longer_determined(self) -> tuple[str, ...]:
        """Parameters of the rig that the extended rig knows clearly less well than the rig as described does; it refutes no value."""
        known = {} if self.improvement is None else self.improvement.known_before
        return tuple(n for n, (_, sd) in known.items() if self.value_sd(n) > policy.KNOWN_AS_WELL * sd)

    def to_json(self) -> dict[str, Any]:
        """Content of `diagnosis.json`."""
        findings, left_open, improvement = self.findings, self.left_open, self.improvement
        left, scatter, pull = findings.answer.left, findings.scatter, findings.pull
        result: dict[str, Any] = {
            "verdict": str(self.verdict),
            "p_not_in_library": self.p_not_in_library,
            "ended_early": findings.answer.ended_early,
            "causes": [cause.to_json() for cause in self.sized_causes],
            "stand_ins": [
                {"name": self.label(c), "place": c.place, "parameters": intervals_to_json(self.quantities(c))}
                for c in self.findings.stand_ins
            ],
            "flagged": [flag.to_json(self.sensor_names) for flag in self.findings.flags],
            "outliers": [outlier.to_json() for outlier in self.findings.outliers],
            "flagged_in_validation": [
                flag.to_json(self.sensor_names) for flag in self.findings.judging_flags
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
                    "place": visible.cause.place,
                    "at": dict(visible.at),
                    "share_absorbed": visible.share_absorbed,
                    "absorbed_by": list(visible.absorbed_by),
                    "hidden_sd": visible.hidden_sd,
                    "hidden_in": visible.hidden_in,
                    "hidden_size": visible.hidden_size,
                    "hidden_at": dict(visible.hidden_at),
                }
                for visible in left_open.visible
            },
            "signatures": {"before": self.fits.before.to_json(), "after": self.fits.after.to_json()},
            "unexplained": {
                "log_bayes_factor": left.log_bayes_factor,
                "looks_like": left.words,
                "rms_sigma": left.rms_sigma,
            },
            "scatter": {
                "log_bayes_factor": scatter.log_bayes_factor,
                "depends_on": scatter.along,
            },
            "pull": {
                "log_bayes_factor": pull.log_bayes_factor,
                "parameter": pull.name,
                "widths": pull.widths,
            },
            "mixture": findings.answer.to_json(),
            "correction": None if self.fits.correction is None else self.fits.correction.to_json(),
            "budget": None if self.fits.budget is None else self.fits.budget.to_json(),
            "rig_parameters": intervals_to_json(self.rig_numbers()),
            "widening": {} if left_open.widening is None else left_open.widening.factors,
            "steps": [self._comparison_json(comparison) for _, comparison in self.comparisons],
            "seed": self.question.seed,
        }
        if improvement is not None:
            result["gain"] = {"before": improvement.before.to_json(), "after": improvement.after.to_json()}
            result["elpd_difference"] = improvement.elpd_difference
            result["elpd_se"] = improvement.elpd_se
            loosened = self.no_longer_determined
            result["moved_sd"] = {n: sd for n, sd in improvement.moved_sd.items() if n not in loosened}
            result["no_longer_determined"] = list(loosened)
        return result

    def _comparison_json(self, comparison: Comparison) -> dict[str, Any]:
        return {
            "taken": self.label(comparison.taken[0]) if comparison.taken else None,
            "considered": [
                {
                    "name": self.label_of_hypothesis(hypothesis),
                    "log_bayes_factor": hypothesis.log_bayes_factor,
                    "probability": hypothesis.probability,
                }
                for hypothesis in comparison.hypotheses
            ],
        }

    def save(self, folder: Path) -> None:
        """Write `diagnosis.json`, sealed by its SHA-256, and `rig_extended.yaml`."""
        write_text(folder / DIAGNOSIS, sealed(self.to_json(), indent=2))
        note = NOTE if self.extended_rig.acting else ""
        write_text(folder / EXTENDED_RIG, rig_text(self.extended_rig, note))

    def _interval(self, name: str) -> Interval:
        """Interval of a number of the extended rig: from its posterior draws, else by Laplace; widened by what remains unexplained."""
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
            named.p_not_in_library,
            named.may_be_unknown,
            named.alternatives,
            tuple(self.label(alternative.cause) for alternative in named.alternatives),
            named.log_bayes_factor,
            self.quantities(named.cause),
            difference=clearest_difference(
                self.fits.final, named.cause, self.posterior, self.left_open.widening
            ),
        )

    def _sized_mistake(self, mistake: RecordMistake) -> SizedCause:
        weights = torch.softmax(torch.tensor([0.0, *(value for _, value in mistake.twins)]), 0).tolist()
        twins = zip((cause for cause, _ in mistake.twins), weights[1:], strict=True)
        alternatives = tuple(Alternative(cause, probability, None) for cause, probability in twins)
        named = NamedCause(mistake.cause, weights[0], alternatives, mistake.log_bayes_factor)
        return replace(self._sized(named), is_record_mistake=True)

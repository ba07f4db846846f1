"""The result of a diagnosis, and its JSON form `diagnosis.json` (docs/file-formats.md)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.calibration.files import CALIBRATION
from estimator.calibration.result import Calibration
from estimator.diagnosis.extension import NOTE
from estimator.diagnosis.findings import Findings, Fits, LeftOpen, Question
from estimator.diagnosis.fit_journal import FITS
from estimator.diagnosis.intervals import CLEARLY_LARGER, Intervals
from estimator.diagnosis.mixture.comparison import Comparison, Hypothesis
from estimator.diagnosis.sizes import Interval, SizedCause, intervals_to_json
from estimator.diagnosis.validation import Improvement
from estimator.diagnosis.verdict import NamedCause, Verdict
from estimator.effects import EFFECTS
from estimator.glance import Shown
from estimator.json_files import sealed
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.write import rig_text
from estimator.store.files import write_text
from estimator.store.made import Made, holds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "Findings", "Fits", "LeftOpen", "Question"]

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


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
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
    def record_mistakes(self) -> tuple[NamedCause, ...]:
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

    def label_of_hypothesis(self, hypothesis: Hypothesis) -> str:
        """Name of the hypothesis' cause; else `nothing` or `unexplained`."""
        return hypothesis.name if hypothesis.cause is None else self.label(hypothesis.cause)

    @property
    def comparisons(self) -> list[tuple[str, Comparison]]:
        """In the place of each stated cause all hypotheses, with the names of what was stated; last, beside all that leads."""
        return [
            (" or ".join(map(self.label, comparison.taken)) or "nothing more", comparison)
            for comparison in self.findings.answer.comparisons
        ]

    def evidence(self) -> dict[str, float]:
        """Log Bayes factor of every hypothesis against nothing, each alone."""
        return {
            self.label_of_hypothesis(hypothesis): hypothesis.log_bayes_factor
            for hypothesis in self.findings.answer.alone.hypotheses
        }

    @property
    def p_not_in_library(self) -> float:
        """Probability that something is there which no list holds: beside the named causes, or instead of one."""
        findings = self.findings
        left = max(findings.answer.p_unlisted, findings.scatter.probability, findings.pull.probability)
        return max(left, *(cause.p_not_in_library for cause in self.causes), 0.0)

    @cached_property
    def intervals(self) -> Intervals:
        """Intervals of the numbers of the extended rig."""
        return Intervals(self.fits.final, self.posterior, self.left_open.widening)

    @cached_property
    def sized_causes(self) -> tuple[SizedCause, ...]:
        """Mistakes of the record, then the named causes, with their sizes."""
        mistakes = (self._sized(named, True) for named in self.record_mistakes)
        return (*mistakes, *map(self._sized, self.causes))

    def quantities(self, cause: Cause) -> dict[str, Interval]:
        """Quantities of a cause that the session can see, by SI key."""
        return self.intervals.quantities(cause)

    def rig_numbers(self) -> dict[str, Interval]:
        """Free parameters of the rig as described."""
        parameters = self.fits.final.rig.parameters
        return {p.name: self.intervals.of(p.name) for p in self.rig.free if p.name in parameters}

    def value_sd(self, name: str) -> float:
        """Standard deviation of a free parameter of the extended rig by Laplace, widened by what remains unexplained."""
        return self.intervals.sd(name)

    @property
    def no_longer_determined(self) -> tuple[str, ...]:
        """Parameters of the rig that the extended rig knows clearly less well than the rig as described does; it refutes no value."""
        known = {} if self.improvement is None else self.improvement.known_before
        return tuple(n for n, (_, sd) in known.items() if self.value_sd(n) > CLEARLY_LARGER * sd)

    def to_json(self) -> dict[str, Any]:
        """Content of `diagnosis.json`."""
        findings, fits, left_open = self.findings, self.fits, self.left_open
        sensors = self.sensor_names
        return {
            "verdict": str(self.verdict),
            "p_not_in_library": self.p_not_in_library,
            "ended_early": findings.answer.ended_early,
            "causes": [cause.to_json() for cause in self.sized_causes],
            "stand_ins": [
                {"name": self.label(c), "place": c.place, "parameters": intervals_to_json(self.quantities(c))}
                for c in findings.stand_ins
            ],
            "flagged": [flag.to_json(sensors) for flag in findings.flags],
            "outliers": [outlier.to_json() for outlier in findings.outliers],
            "flagged_in_validation": [flag.to_json(sensors) for flag in findings.judging_flags],
            "indistinguishable": [[self.label(cause) for cause in group] for group in left_open.twins],
            "next_measurement": [proposal.to_json() for proposal in left_open.next_measurements],
            "smallest_visible": {
                f"{self.label(visible.cause)}.{visible.key}": visible.to_json()
                for visible in left_open.visible
            },
            "signatures": {"before": fits.before.to_json(), "after": fits.after.to_json()},
            **findings.doubts_to_json(),
            "mixture": findings.answer.to_json(),
            "correction": None if fits.correction is None else fits.correction.to_json(),
            "budget": None if fits.budget is None else fits.budget.to_json(),
            "rig_parameters": intervals_to_json(self.rig_numbers()),
            "widening": {} if left_open.widening is None else left_open.widening.factors,
            "steps": [self._comparison_json(comparison) for _, comparison in self.comparisons],
            "seed": self.question.seed,
            **({} if self.improvement is None else self._gain_json(self.improvement)),
        }

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

    def _gain_json(self, improvement: Improvement) -> dict[str, Any]:
        loosened = self.no_longer_determined
        return {
            "gain": {"before": improvement.before.to_json(), "after": improvement.after.to_json()},
            "elpd_difference": improvement.elpd_difference,
            "elpd_se": improvement.elpd_se,
            "moved_sd": {n: sd for n, sd in improvement.moved_sd.items() if n not in loosened},
            "no_longer_determined": list(loosened),
        }

    def save(self, folder: Path) -> None:
        """Write `diagnosis.json`, sealed by its SHA-256, and `rig_extended.yaml`."""
        write_text(folder / DIAGNOSIS, sealed(self.to_json(), indent=2))
        note = NOTE if self.extended_rig.acting else ""
        write_text(folder / EXTENDED_RIG, rig_text(self.extended_rig, note))

    def plot_residuals(self, ax: Axes | None = None, extended: bool = True) -> Axes:
        """Residuals over the noise beside the normal density (`plots.residual_histogram`).

        Args:
            ax: Axes to draw into; a new figure by default.
            extended: With the causes that were found; False for the rig as described.
        Examples:
            >>> diagnosis.plot_residuals().figure.savefig("residuals.png")  # doctest: +SKIP
        """
        return self._shown.plot_residuals(self, ax, extended)

    def plot_budget(self) -> Figure:
        """Share of the error on unseen readings that each cause accounts for (`plots.error_budget`).

        Raises:
            InvalidInput: There is no budget, for nothing was found or no reading was kept out of the fits.
        """
        return self._shown.plot_budget(self)

    def _sized(self, named: NamedCause, is_record_mistake: bool = False) -> SizedCause:
        return SizedCause(
            named,
            self.label(named.cause),
            tuple(self.label(alternative.cause) for alternative in named.alternatives),
            self.quantities(named.cause),
            is_record_mistake,
            self.intervals.difference(named.cause),
        )

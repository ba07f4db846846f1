"""What a diagnosis consists of: the question, what was found, the fits without and with it, and what the readings leave open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from estimator.diagnosis.budget import Budget
from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.next_readings.expected_evidence import Proposal
from estimator.diagnosis.next_readings.resolution import Visible
from estimator.diagnosis.outlying import Outlier
from estimator.diagnosis.structure.pull import Pull
from estimator.diagnosis.structure.scatter import Scatter
from estimator.diagnosis.structure.symptoms import Symptoms
from estimator.diagnosis.validation import Improvement
from estimator.diagnosis.verdict import NamedCause
from estimator.diagnosis.widening import Widening
from estimator.readings.flags import Flag
from estimator.rig.rig import Cause, Rig


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
        record_mistakes: Mistakes of the record, undone before, with others that would explain the readings as well.
        causes: The named causes, surest first.
        stand_ins: Further causes of the extended rig, which are not sure enough to be stated.
        flags: Readings that cannot have been measured as they were recorded. What they hold was left out.
        judging_flags: The same of another session, which judges the fits.
        outliers: Components that are probably wrong, those that miss most first.
    """

    answer: Answer
    scatter: Scatter
    pull: Pull
    record_mistakes: tuple[NamedCause, ...] = ()
    causes: tuple[NamedCause, ...] = ()
    stand_ins: tuple[Cause, ...] = ()
    flags: tuple[Flag, ...] = ()
    judging_flags: tuple[Flag, ...] = ()
    outliers: tuple[Outlier, ...] = ()

    def doubts_to_json(self) -> dict[str, Any]:
        """What no list holds, what scatters, and what is pulled, in the form of `diagnosis.json`."""
        left, scatter, pull = self.answer.left, self.scatter, self.pull
        return {
            "unexplained": {
                "log_bayes_factor": left.log_bayes_factor,
                "looks_like": left.words,
                "rms_sigma": left.rms_sigma,
            },
            "scatter": {"log_bayes_factor": scatter.log_bayes_factor, "depends_on": scatter.along},
            "pull": {
                "log_bayes_factor": pull.log_bayes_factor,
                "parameter": pull.name,
                "widths": pull.widths,
            },
        }


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

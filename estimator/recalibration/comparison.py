"""A session beside the current calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from estimator.calibration.result import Calibration
from estimator.calibration.summary import finite
from estimator.diagnosis import effort, policy
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements.priors import held_back
from estimator.diagnosis.validation import Improvement, improvement_of
from estimator.inference.ensemble import SamplerSettings
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.split import thinned
from estimator.recalibration.agreement import Agreement, agreement
from estimator.recalibration.conclusion import (
    EVIDENCE,
    IS_CONVERGED,
    Conclusion,
    Judgement,
    mistake_in,
    sizes_of,
    words_of,
)
from estimator.recalibration.successor import (
    causes_of,
    estimate_of,
    is_unexplained,
    sampled_successor,
    short_of,
    stored_log_density,
)
from estimator.recalibration.watcher import UNWATCHED, Watcher
from estimator.reporting.numbers import displays, percent, size_with_unit
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from estimator.units import split_quotient

SMALLEST_SHOWN = 1e-4  # p-value: fewer simulated sessions than that tell no difference


@dataclass(frozen=True)
class Comparison:
    """A session beside the current calibration."""

    session: Session
    current: Calibration
    widened: Rig
    refit: Fit
    agreement: Agreement
    seed: int
    watcher: Watcher = UNWATCHED

    @classmethod
    def of(
        cls, session: Session, widened: Rig, current: Calibration, seed: int, watcher: Watcher = UNWATCHED
    ) -> Comparison:
        """Refit the session within the widened rig, and test it against the current calibration."""
        tested = thinned(session.observations, effort.MOST_READINGS_SEARCHED, seed)
        model = MeasurementModel.build(widened, tested)
        refit = fit_rig(widened, tested, widened.nominal_values(), model.rules)
        return cls(session, current, widened, refit, agreement(current, tested, refit, seed), seed, watcher)

    def judgement(
        self, settings: SamplerSettings | None, earlier: Sequence[Mapping[str, float]], may_replace: bool
    ) -> Judgement:
        """The conclusion: unchanged where it agrees, else what a diagnosis says; arguments as those of `judge`."""
        if self.agreement.holds:
            return self._judgement(
                Conclusion.UNCHANGED, f"agrees with the current version ({self._p_value()})"
            )
        diagnosis = diagnose(
            self.session,
            self.widened,
            seed=self.seed,
            limits=Limits(is_of_change=True),
            on_stage=self.watcher.on_words,
            on_progress=self.watcher.on_progress,
        )
        if diagnosis.is_record_wrong:
            return self._judgement(Conclusion.REJECTED, mistake_in(diagnosis), diagnosis)
        if is_unexplained(diagnosis) or not (diagnosis.causes or self.agreement.is_refit_enough):
            if earlier and (names := named_together([*earlier, diagnosis.evidence()])):
                return self._together(diagnosis, names, len(earlier) + 1)
            return self._judgement(Conclusion.REJECTED, self._unexplained(), diagnosis)
        return self._explained(diagnosis, settings, may_replace)

    def _explained(
        self, diagnosis: Diagnosis, settings: SamplerSettings | None, may_replace: bool
    ) -> Judgement:
        """Conclusion where other values or a cause explain the readings: the current version is replaced or stays."""
        improvement = self._improvement(diagnosis)
        grown = None if diagnosis.causes or not improvement.is_significant else self._grown(improvement)
        drifts = bool(diagnosis.causes) or grown is not None
        stays = Conclusion.DRIFTED if drifts else Conclusion.UNCHANGED
        what = f"disagrees with the current version ({self._p_value()})"
        if diagnosis.causes:
            what = sizes_of(diagnosis)
        elif grown is not None:
            what = self._corrected_otherwise(diagnosis, grown)
        elif improvement.is_significant:
            what = self._moved(diagnosis, improvement)
        held = "".join(f". {sentence.rstrip('.')}" for sentence in held_back(diagnosis))
        reason = f"{what}; {words_of(improvement)}{held}"
        if not (improvement.is_significant and may_replace):
            return self._judgement(stays, reason, diagnosis, improvement)
        successor = sampled_successor(self.session, diagnosis, self.seed, settings, self.watcher)
        is_converged, stored = bool(successor.summary()["is_converged"]), self._stored_improvement(successor)
        sampled = {IS_CONVERGED: is_converged, "stored_elpd_difference": finite(stored)}
        if is_converged and stored > 0.0:
            replaced = Conclusion.DRIFTED if drifts else Conclusion.UPDATED
            return self._judgement(replaced, reason, diagnosis, improvement, successor, sampled)
        doubt = (
            f"its sampled posterior predicts them worse (log density {stored:+.1f})"
            if is_converged
            else short_of(successor)
        )
        reason = f"{reason}, but {doubt}: the current version stays"
        return self._judgement(stays, reason, diagnosis, improvement, None, sampled)

    def _judgement(
        self,
        conclusion: Conclusion,
        reason: str,
        diagnosis: Diagnosis | None = None,
        improvement: Improvement | None = None,
        successor: Calibration | None = None,
        sampled: Mapping[str, Any] | None = None,
    ) -> Judgement:
        checks: dict[str, Any] = {
            "p_value": self.agreement.p_value,
            "p_values": self.agreement.by_test,
            "p_value_after_refit": self.agreement.left_p_value,
            "rms_sigma": self.agreement.rms_sigma,
            "striking_cause": self.agreement.striking_cause,
        }
        if diagnosis is not None:
            checks |= {
                "verdict": str(diagnosis.verdict),
                "lack_of_fit_p": diagnosis.fits.before.lack_of_fit.p_value,
            }
            if not diagnosis.is_record_wrong:
                checks[EVIDENCE] = diagnosis.evidence()
        if improvement is not None:
            checks |= {
                "elpd_difference": finite(improvement.elpd_difference),
                "elpd_se": finite(improvement.elpd_se),
                "moved_sd": {name: finite(value) for name, value in improvement.moved_sd.items()},
            }
        checks |= sampled or {}
        return Judgement(
            conclusion,
            reason,
            successor,
            self.agreement.holds,
            causes_of(diagnosis)
            if diagnosis is not None and (diagnosis.is_record_wrong or conclusion is Conclusion.DRIFTED)
            else (),
            checks,
            estimate_of(self.refit),
        )

    def _together(self, diagnosis: Diagnosis, names: Mapping[str, float], n: int) -> Judgement:
        """A drift that several sessions name together and none alone: its size is too uncertain for a new version."""
        (first, probability), *others = names.items()
        words = " or ".join(names)
        reason = f"{words}, by {n} sessions in a row together, none of which names it alone; the current version stays"
        cause = {
            "name": first,
            "probability": probability,
            "alternatives": [{"name": name, "probability": share} for name, share in others],
            "parameters": {},
        }
        return replace(self._judgement(Conclusion.DRIFTED, reason, diagnosis), causes=(cause,))

    def _improvement(self, diagnosis: Diagnosis) -> Improvement:
        """The extended rig of the diagnosis against the current version, on readings that neither was fitted to."""
        fitted = thinned(self.current.observations.calibration, effort.MOST_READINGS_FITTED, self.seed)
        rules = MeasurementModel.build(self.current.rig, fitted).rules
        before = fit_rig(self.current.rig, fitted, self.current.best, rules)
        return improvement_of(before, diagnosis.fits.final, self._unseen())

    def _stored_improvement(self, successor: Calibration) -> float:
        """Difference of log predictive density, successor less current version, both from their stored draws."""
        before, after = (
            stored_log_density(calibration, self._unseen()) for calibration in (self.current, successor)
        )
        return float((after - before).sum())

    def _unseen(self) -> Observations:
        return thinned(self.session.observations.validation, effort.MOST_READINGS_FITTED, self.seed)

    def _p_value(self) -> str:
        p = self.agreement.p_value
        return f"p = {p:.2g}" if p >= SMALLEST_SHOWN else f"p < {SMALLEST_SHOWN:g}"

    def _unexplained(self) -> str:
        like = f"most like {self.agreement.striking_cause or 'nothing known'}"
        return (
            f"disagrees with the current version ({self._p_value()}): residuals are {self.agreement.rms_sigma:.3g} times the noise; "
            f"neither a refit nor a cause that can be named explains them ({like})"
        )

    def _grown(self, improvement: Improvement) -> Cause | None:
        """The correction whose amplitude moved most of all parameters; None where something else did."""
        name = max(improvement.moved_sd, key=lambda name: abs(improvement.moved_sd[name]))
        label = name.rpartition(".")[0]
        return next((cause for cause in self.current.rig.corrections if cause.label == label), None)

    def _corrected_otherwise(self, diagnosis: Diagnosis, correction: Cause) -> str:
        """What is corrected without a name and changed, with the rms of its amplitudes."""
        names = [p.name for p in self.current.rig.free if p.name.startswith(f"{correction.label}.")]
        unit = self.current.rig.parameters[names[0]].unit
        before, after = (
            math.sqrt(sum(float(values[name]) ** 2 for name in names) / len(names))
            for values in (self.current.best, diagnosis.fits.final.values)
        )
        return (
            f"what {correction.label} corrects without a name has changed ({self._p_value()}): its amplitudes from "
            f"{size_with_unit(before, unit)} to {size_with_unit(after, unit)} rms"
        )

    def _moved(self, diagnosis: Diagnosis, improvement: Improvement) -> str:
        """The parameter that moved most, in words."""
        name, distance = max(improvement.moved_sd.items(), key=lambda item: abs(item[1]))
        show, old, sd = (
            displays([name])[name],
            self.current.summary()["parameters"][name],
            diagnosis.fits.final.value_sd(name),
        )
        before = show.with_sd(old["median"], old["sd"])
        after = show.with_sd(float(diagnosis.fits.final.values[name]), sd)
        return (
            f"the same model explains the readings with other values ({self._p_value()} for the old ones): "
            f"{self._read_otherwise(diagnosis.fits.final)}. "
            f"Of single numbers {split_quotient(name)[0]} moved most, by {distance:+.1f} standard deviations, "
            f"from {before} to {after} {show.unit}".rstrip()
        )

    def _read_otherwise(self, refit: Fit) -> str:
        """What other values do at the places of the session, in words: numbers that do alike share a change as their priors like it."""
        observations = self._unseen()
        idle = replace(observations, current_A=torch.zeros_like(observations.current_A))
        of_coils_T, without_T = [], []
        for rig, values in ((self.current.rig, self.current.best_values()), (refit.rig, refit.values)):
            read_T, without = (
                MeasurementModel.for_values(rig, readings, values).predict(values).expand(len(readings), 3)
                for readings in (observations, idle)
            )
            of_coils_T.append((read_T - without)[observations.is_measured])
            without_T.append(without[observations.is_measured])
        zero_T = float((without_T[1] - without_T[0]).square().mean().sqrt())
        otherwise = f"without current components differ by {size_with_unit(zero_T, 'T')}"
        before_T, after_T = of_coils_T
        if not bool(before_T.any()):
            return otherwise
        ratio = float((before_T * after_T).sum() / before_T.square().sum())
        pattern = float((after_T - ratio * before_T).norm() / before_T.norm())
        way = "larger" if ratio >= 1.0 else "smaller"
        return (
            f"where it was read the coils' field is {percent(abs(ratio - 1.0), 2)} {way} and its pattern differs by "
            f"{percent(pattern, 2)}; {otherwise}"
        )


NOTHING, UNEXPLAINED = "nothing", "unexplained"  # hypotheses beside the causes


def named_together(sessions: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The 95 % credible set of causes after several disagreeing sessions in a row, most probable first.

    Each session gives a Bayes factor of every cause with its own size of the cause. Sessions are independent given the cause, so their
    Bayes factors multiply; a cause that leads in one session by chance falls behind in the next.

    Args:
        sessions: Log Bayes factor of each hypothesis against nothing, by name, for each session.
    Returns: Probabilities among all causes; empty while no cause, or an unknown one, is not ruled out.

    Examples:
        >>> session = {"offset_drift": 3.0, "coil_heating": -1.0, "unexplained": 1.0}
        >>> named_together([session]), list(named_together([session, session]))
        ({}, ['offset_drift'])
    """
    if not sessions:
        return {}
    common = set.intersection(*(set(session) for session in sessions)) - {NOTHING}
    total = {name: sum(session[name] for session in sessions) for name in common}
    unexplained = total.pop(UNEXPLAINED, 0.0)
    if not total:
        return {}
    least = max(policy.CLEAR_LOG_EVIDENCE - policy.LOG_PRIOR_ODDS_LEFT, unexplained)
    ranked = sorted(total, key=lambda name: (-total[name], name))
    if total[ranked[0]] - math.log(len(ranked)) <= least:
        return {}
    shares = torch.softmax(torch.tensor([total[name] for name in ranked], dtype=torch.float64), 0)
    n = int((torch.cumsum(shares, 0) < 1.0 - policy.ALTERNATIVE).sum()) + 1
    return dict(zip(ranked[:n], shares[:n].tolist(), strict=True))

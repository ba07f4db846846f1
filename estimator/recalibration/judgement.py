"""The conclusion on one new session beside the current calibration, and the calibration that would replace it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import torch

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.calibration.summary import finite
from estimator.diagnosis import policy as diagnosis_policy
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.validation import Improvement, improvement_of
from estimator.diagnosis.verdict import Verdict
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.model.measurement_model import MeasurementModel
from estimator.model.preflight import check_readings, check_units
from estimator.readings.observations import Observations
from estimator.readings.split import block_split, thinned
from estimator.recalibration import policy
from estimator.recalibration.agreement import Agreement, agreement
from estimator.recalibration.stored import stored_log_density
from estimator.recalibration.together import named_together
from estimator.recalibration.widening import widened_rig
from estimator.recalibration.words import mistake_in, names_of, sizes_of, words_of
from estimator.reporting.numbers import displays, with_sd
from estimator.rig.rig import Rig
from estimator.store.session import Session
from estimator.units import split_unit

EVIDENCE = "log_bayes_factors"  # among the checks of a session that was diagnosed
IS_CONVERGED = "is_successor_converged"  # among the checks of a session that was sampled
SMALLEST_SHOWN = 1e-4  # p-value: fewer simulated sessions than that tell no difference


class Conclusion(StrEnum):
    """Outcome of one session; the words are stable."""

    UNCHANGED = "unchanged"
    UPDATED = "updated"
    DRIFTED = "drifted"
    REJECTED = "rejected"


@dataclass(frozen=True)
class Judgement:
    """Conclusion on a session, with its reason and numbers.

    Attributes:
        conclusion: One of four.
        reason: Reason in one sentence, with the numbers.
        calibration: Replaces the current one; None if that stays.
        agrees: Whether the session agrees with the current version; None if they could not be compared.
        causes: Causes of a drift, or mistakes of the record, as in `diagnosis.json`.
        checks: Numbers behind the conclusion.
        estimate: Value and standard deviation of every parameter from this session within the widened prior.
    """

    conclusion: Conclusion
    reason: str
    calibration: Calibration | None = None
    agrees: bool | None = None
    causes: tuple[Mapping[str, Any], ...] = ()
    checks: Mapping[str, Any] = field(default_factory=dict)
    estimate: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def judge(
    session: Session,
    rig: Rig,
    current: Calibration | None,
    *,
    earlier: Sequence[Mapping[str, float]] = (),
    may_replace: bool = True,
    seed: int = 0,
    settings: SamplerSettings | None = None,
) -> Judgement:
    """Conclude on one session.

    Args:
        session: The new readings. Those marked as validation judge a successor; if none is marked, a fifth is kept out in blocks.
        rig: Rig as the user describes it.
        current: The calibration in use; None before the first.
        earlier: Log Bayes factors of the preceding sessions that disagreed with the current version and led to no new one.
        may_replace: False for readings older than those of the version in use: they are judged but lead to no new version.
        seed: Seed of all random numbers.
        settings: When to stop sampling a successor.
    Raises:
        InvalidInput: The rig or the current calibration cannot be used. Faults of the session do not raise: they lead to a rejection.
    """
    widened = None if current is None else widened_rig(current, rig)
    try:
        session.check_rig(rig)
        check_readings(rig, session.observations, session.source)
        check_units(rig, session.observations.calibration, session.source)
        session = _with_held_out(session, seed)
        if current is None or widened is None:
            return _first(session, rig, seed, settings)
        return _Comparison.of(session, widened, current, seed).judgement(settings, earlier, may_replace)
    except (InvalidInput, torch.linalg.LinAlgError) as error:  # type: ignore[attr-defined]
        return Judgement(Conclusion.REJECTED, f"the readings cannot be used: {error}")


def _with_held_out(session: Session, seed: int) -> Session:
    observations = session.observations
    if bool(observations.is_validation.any()):
        return session
    split = block_split(observations, diagnosis_policy.VALIDATION_SHARE, seed)
    return replace(session, observations=observations.with_validation(split))


def _first(session: Session, rig: Rig, seed: int, settings: SamplerSettings | None) -> Judgement:
    diagnosis = diagnose(session, rig, seed=seed)
    if diagnosis.record_mistakes:
        return Judgement(Conclusion.REJECTED, mistake_in(diagnosis), causes=_causes(diagnosis))
    calibration = _sampled(session, diagnosis, seed, settings)
    named = f", with {names_of(diagnosis)} in the rig" if diagnosis.causes else ""
    left = "; structure is left that no known cause explains" if _is_unexplained(diagnosis) else ""
    unsure = (
        ""
        if calibration.summary()["is_converged"]
        else f"; {_short_of(calibration)}, intervals are provisional"
    )
    return Judgement(
        Conclusion.UPDATED,
        f"first calibration{named}{left}{unsure}",
        calibration,
        causes=_causes(diagnosis),
        checks={"verdict": str(diagnosis.verdict), IS_CONVERGED: calibration.summary()["is_converged"]},
        estimate=_estimate(diagnosis.fits.final),
    )


@dataclass(frozen=True)
class _Comparison:
    """A session beside the current calibration."""

    session: Session
    current: Calibration
    widened: Rig
    refit: Fit
    agreement: Agreement
    seed: int

    @classmethod
    def of(cls, session: Session, widened: Rig, current: Calibration, seed: int) -> _Comparison:
        tested = thinned(session.observations, diagnosis_policy.MOST_READINGS_SEARCHED, seed)
        model = MeasurementModel.build(widened, tested)
        refit = fit_rig(widened, tested, widened.nominal_values(), model.rules)
        return cls(session, current, widened, refit, agreement(current, tested, refit, seed), seed)

    def judgement(
        self, settings: SamplerSettings | None, earlier: Sequence[Mapping[str, float]], may_replace: bool
    ) -> Judgement:
        if self.agreement.holds:
            return self._judgement(
                Conclusion.UNCHANGED, f"agrees with the current version ({self._p_value()})"
            )
        diagnosis = diagnose(self.session, self.widened, seed=self.seed)
        if diagnosis.record_mistakes:
            return self._judgement(Conclusion.REJECTED, mistake_in(diagnosis), diagnosis)
        if _is_unexplained(diagnosis) or not (diagnosis.causes or self.agreement.is_refit_enough):
            if earlier and (names := named_together([*earlier, diagnosis.evidence()])):
                return self._together(diagnosis, names, len(earlier) + 1)
            return self._judgement(Conclusion.REJECTED, self._unexplained(), diagnosis)
        return self._explained(diagnosis, settings, may_replace)

    def _explained(
        self, diagnosis: Diagnosis, settings: SamplerSettings | None, may_replace: bool
    ) -> Judgement:
        """Conclusion where other values or a cause explain the readings: the current version is replaced or stays."""
        improvement = self._improvement(diagnosis)
        stays = Conclusion.DRIFTED if diagnosis.causes else Conclusion.UNCHANGED
        what = f"disagrees with the current version ({self._p_value()})"
        if diagnosis.causes:
            what = sizes_of(diagnosis)
        elif improvement.is_significant:
            what = self._moved(diagnosis, improvement)
        reason = f"{what}; {words_of(improvement)}"
        if not (improvement.is_significant and may_replace):
            return self._judgement(stays, reason, diagnosis, improvement)
        successor = _sampled(self.session, diagnosis, self.seed, settings)
        is_converged, stored = bool(successor.summary()["is_converged"]), self._stored_improvement(successor)
        sampled = {IS_CONVERGED: is_converged, "stored_elpd_difference": finite(stored)}
        if is_converged and stored > 0.0:
            replaced = Conclusion.DRIFTED if diagnosis.causes else Conclusion.UPDATED
            return self._judgement(replaced, reason, diagnosis, improvement, successor, sampled)
        doubt = (
            f"its sampled posterior predicts them worse (log density {stored:+.1f})"
            if is_converged
            else _short_of(successor)
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
            if not diagnosis.record_mistakes:
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
            _causes(diagnosis)
            if diagnosis is not None and (diagnosis.record_mistakes or conclusion is Conclusion.DRIFTED)
            else (),
            checks,
            _estimate(self.refit),
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
        fitted = thinned(
            self.current.observations.calibration, diagnosis_policy.MOST_READINGS_FITTED, self.seed
        )
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
        return thinned(self.session.observations.validation, diagnosis_policy.MOST_READINGS_FITTED, self.seed)

    def _p_value(self) -> str:
        p = self.agreement.p_value
        return f"p = {p:.2g}" if p >= SMALLEST_SHOWN else f"p < {SMALLEST_SHOWN:g}"

    def _unexplained(self) -> str:
        like = f"most like {self.agreement.striking_cause or 'nothing known'}"
        return (
            f"disagrees with the current version ({self._p_value()}): residuals are {self.agreement.rms_sigma:.3g} times the noise; "
            f"neither a refit nor a cause that can be named explains them ({like})"
        )

    def _moved(self, diagnosis: Diagnosis, improvement: Improvement) -> str:
        """The parameter that moved most, in words."""
        name, distance = max(improvement.moved_sd.items(), key=lambda item: abs(item[1]))
        show, old, sd = (
            displays([name])[name],
            self.current.summary()["parameters"][name],
            diagnosis.fits.final.value_sd(name),
        )
        before, after = (
            with_sd(value * show.factor, width * show.factor)
            for value, width in ((old["median"], old["sd"]), (float(diagnosis.fits.final.values[name]), sd))
        )
        return (
            f"the same model explains the readings with other values ({self._p_value()} for the old ones): {split_unit(name)[0]} moved by "
            f"{distance:+.1f} standard deviations, from {before} to {after} {show.unit}".rstrip()
        )


def _sampled(
    session: Session, diagnosis: Diagnosis, seed: int, settings: SamplerSettings | None
) -> Calibration:
    """Sample the extended rig of a diagnosis; its causes may need more walkers than were asked for."""
    rig = diagnosis.extended_rig
    if settings is not None and settings.n_walkers:
        n = len(rig.free)
        settings = replace(settings, n_walkers=max(settings.n_walkers, 2 * n, n + 2))
    return calibrate(session, rig, seed=seed, settings=settings)


def _short_of(calibration: Calibration) -> str:
    """How sampling fell short of its targets, in words."""
    sampling = calibration.summary()["sampling"]
    rhat = sampling["largest_rhat"]
    numbers = f"{sampling['smallest_ess']:.0f} effective samples, R-hat {'unknown' if rhat is None else f'{rhat:.3f}'}"
    return f"its posterior did not converge ({numbers})"


def _is_unexplained(diagnosis: Diagnosis) -> bool:
    """Whether the residual exceeds noise, in structure or in size."""
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        return True
    return diagnosis.fits.after.lack_of_fit.p_value < policy.FALSE_ALARMS


def _causes(diagnosis: Diagnosis) -> tuple[Mapping[str, Any], ...]:
    """Causes as in the log and `diagnosis.json`."""
    return tuple(cause.to_json() for cause in diagnosis.sized_causes)


def _estimate(fit: Fit) -> dict[str, tuple[float, float]]:
    return {
        parameter.name: (float(fit.values[parameter.name]), fit.value_sd(parameter.name))
        for parameter in fit.rig.free
    }

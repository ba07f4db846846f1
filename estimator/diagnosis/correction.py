"""Corrections for what is left where no known cause explains it: which smooth fields and responses the readings support, and how well.

Kinds and degrees are compared by their evidence in the linear model at a fit. The best is fitted in full, with its amplitudes among the
parameters, and taken if blocks of places held out are predicted better. Then the rest is asked again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.linear import log_mean_exp
from estimator.diagnosis.structure.cross_validation import HeldOut, held_out
from estimator.diagnosis.structure.discrepancy import evidence_by_amplitude
from estimator.diagnosis.structure.families.collection import Family
from estimator.diagnosis.validation import Improvement, improvement_of
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.correction import Correction as CorrectionEffect
from estimator.effects.correction import Limit
from estimator.effects.stages import MotionEffect
from estimator.effects.use import Use
from estimator.geometry.motion import base_from_motion
from estimator.model.measurement_model import MeasurementModel, gradient_T_per_m
from estimator.readings.observations import Observations
from estimator.readings.split import pose_blocks
from estimator.rig.coordinates import Values
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig

FRACTION = 5  # of a degree to the next that is asked: between them evidence hardly changes
STEP = 1e-3  # of the typical width of an amplitude, for derivatives; predictions are nearly linear in it


@dataclass(frozen=True)
class Part:
    """One kind of correction at one place, as it was taken.

    Attributes:
        degree: Highest degree of its terms.
        n_amplitudes: Their number.
        log_bayes_factor: Of the full fit, against none of this kind.
        held_out: Gain in predicting blocks of places from the others.
    """

    cause: Cause
    degree: int
    n_amplitudes: int
    log_bayes_factor: float
    held_out: HeldOut


@dataclass(frozen=True)
class Correction:
    """What corrects predictions without a name.

    Attributes:
        fit: Of the readings of the search, with the corrections; as it was where none was taken.
        parts: The corrections, as they were taken.
        limits: By kind and place why no higher degree was asked, or none, and what to measure.
        refusal: Why nothing is corrected; empty where something is.
        final: The same, fitted to more readings.
        gain: On unseen readings, over the causes alone; None where there are none, or nothing was taken.
    """

    fit: Fit
    parts: tuple[Part, ...]
    limits: dict[str, str]
    refusal: str
    final: Fit
    gain: Improvement | None = None

    @property
    def is_taken(self) -> bool:
        """Whether predictions are corrected."""
        return not self.refusal

    def words(self, label: Callable[[Cause], str]) -> str:
        """In one sentence, with the names that the diagnosis gives."""
        if not self.is_taken:
            return f"Nothing is corrected: {self.refusal}."
        by = " and ".join(f"{label(part.cause)} to degree {part.degree}" for part in self.parts)
        return f"Predictions are corrected, not explained, by {by}; intervals stay widened by what was left."

    @property
    def limit_words(self) -> str:
        """What stands in the way of a better correction, and what to measure; empty where nothing does."""
        kinds: dict[str, list[str]] = {}
        for label, words in self.limits.items():
            kinds.setdefault(words, []).append(label)
        if not kinds:
            return ""
        each = "; ".join(f"{' and '.join(labels)}: {words}" for words, labels in kinds.items())
        return f"Other readings would allow more. {each}. Run coilcal design --map, which proposes places."

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it."""
        return {
            "parts": [
                {
                    "name": part.cause.name,
                    "place": part.cause.place,
                    "degree": part.degree,
                    "amplitudes": part.n_amplitudes,
                    "log_bayes_factor": part.log_bayes_factor,
                    "held_out": part.held_out.to_json(),
                }
                for part in self.parts
            ],
            "limits": self.limits,
            "refusal": self.refusal,
            "gain": None
            if self.gain is None
            else {
                "with_causes": self.gain.before.to_json(),
                "with_correction": self.gain.after.to_json(),
                "elpd_difference": self.gain.elpd_difference,
                "elpd_se": self.gain.elpd_se,
            },
        }


@dataclass(frozen=True)
class _Kind:
    """A kind of correction at one place that the readings may support.

    Attributes:
        effect, cause: What it is and where.
        starts: What its terms are functions of; several where a frequency is to be found.
        limit: How high a degree they determine.
    """

    effect: CorrectionEffect
    cause: Cause
    starts: tuple[dict[str, float], ...]
    limit: Limit

    def keys(self, degree: int) -> list[tuple[int, str]]:
        """Degree and key of each amplitude up to a degree."""
        degrees = range(self.effect.lowest, degree + 1)
        return [(d, self.effect.key(d, term)) for d in degrees for term in self.effect.terms(d)]

    def rig(self, fit: Fit, start: dict[str, float], widths: dict[str, float], is_free: bool = True) -> Rig:
        """The rig with amplitudes at zero and priors of these widths."""
        zeros = dict.fromkeys(widths, 0.0)
        rig = with_effect(fit.rig, self.cause, fit.observations, {**start, **zeros}, is_free)
        named = {f"{self.cause.label}.{key}": width for key, width in widths.items()}
        return rig.with_parameters(
            replace(rig.parameters[name], prior=Normal(0.0, width) if is_free else None)
            for name, width in named.items()
        )

    def columns(
        self, fit: Fit, starts: Sequence[dict[str, float]], degree: int
    ) -> Float[Tensor, "start component amplitude"]:
        """Whitened change of the predictions per unit of each amplitude up to a degree, which they are nearly linear in.

        Several starts differ in a frequency, which may have a batch.
        """
        step = STEP * self.effect.typical_width(fit.posterior.model.circumstances.extent)
        keys = [key for _, key in self.keys(degree)]
        n = len(starts) * len(keys)
        rig = self.rig(fit, starts[0], dict.fromkeys(keys, 1.0), is_free=False)
        model = MeasurementModel.unruled(rig, fit.observations).with_rules(fit.posterior.model.rules)
        each = step * torch.eye(len(keys), dtype=torch.float64).repeat(len(starts), 1)
        values = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
        values |= fit.values | {f"{self.cause.label}.{key}": each[:, i] for i, key in enumerate(keys)}
        if len(starts) > 1:
            for key in starts[0]:
                shapes = torch.tensor([start[key] for start in starts], dtype=torch.float64)
                values[f"{self.cause.label}.{key}"] = shapes.repeat_interleave(len(keys))
        with torch.no_grad():
            if len(starts) > 1 and isinstance(
                self.effect, MotionEffect
            ):  # many poses, each near the reported one
                change_T = fit.posterior.measured_components(self._shifted_T(fit, model, values))
            else:
                reading_T = model.predict(values).expand(n, len(fit.observations), 3)
                change_T = fit.posterior.measured_components(reading_T) - fit.posterior.predicted(fit.vector)
        changes: Tensor = change_T * fit.whitening_per_T / step
        by_start: Tensor = changes.unflatten(0, (len(starts), len(keys)))
        return by_start.mT

    def _shifted_T(
        self, fit: Fit, model: MeasurementModel, values: Values
    ) -> Float[Tensor, "amplitude reading 3"]:
        """Change of the readings by a mover that errs, to first order in its shift."""
        assert isinstance(self.effect, MotionEffect)
        mover = fit.rig.mover(self.cause.place)
        pose = base_from_motion(mover, fit.observations.motion[mover.name])
        columns = self.effect.columns(model.circumstances, mover.name)
        moved = self.effect.apply(pose, columns, Use(self.effect, mover.name).theta(values))
        slope_T_per_m = gradient_T_per_m(fit.posterior.model, fit.values, mover.name)
        return torch.einsum("rij,arj->ari", slope_T_per_m, moved.translation_m - pose.translation_m)


@dataclass(frozen=True)
class _Option:
    """One kind up to one degree, with the widths of its amplitudes that have most evidence."""

    kind: _Kind
    start: dict[str, float]
    degree: int
    widths: dict[str, float]
    log_bayes_factor: float


@dataclass(frozen=True)
class _Candidate:
    """A kind, with the columns of its amplitudes at the fit that was first.

    Attributes:
        columns: By start: of all degrees where there is one start, else of the lowest.
        of_all_degrees: The others, of starts that were best once.
    """

    kind: _Kind
    first: Fit
    columns: Float[Tensor, "start component amplitude"]
    of_all_degrees: dict[int, Float[Tensor, "component amplitude"]] = field(default_factory=dict)

    @classmethod
    def at(cls, kind: _Kind, fit: Fit) -> _Candidate:
        """At a fit."""
        degree = kind.limit.degree if len(kind.starts) == 1 else kind.effect.lowest
        return cls(kind, fit, kind.columns(fit, kind.starts, degree))

    def best_option(self, fit: Fit) -> _Option:
        """The start, degree and width with most evidence in the residual of a fit; the evidence is averaged over starts and widths."""
        weight = fit.weight_over(self.first)[:, None]
        if len(self.kind.starts) == 1:
            return _best_degree(fit, self.kind, self.kind.starts[0], self.columns[0] * weight)
        families = [Family.of(self.kind.cause.label, own * weight) for own in self.columns]
        by_start = torch.tensor([log_mean_exp(row) for row in evidence_by_amplitude(fit, families)])
        top = int(by_start.argmax())
        if top not in self.of_all_degrees:
            start = [self.kind.starts[top]]
            self.of_all_degrees[top] = self.kind.columns(self.first, start, self.kind.limit.degree)[0]
        option = _best_degree(fit, self.kind, self.kind.starts[top], self.of_all_degrees[top] * weight)
        lost = float(by_start.max()) - log_mean_exp(by_start)
        return replace(option, log_bayes_factor=option.log_bayes_factor - lost)


def _best_degree(
    fit: Fit, kind: _Kind, start: dict[str, float], columns: Float[Tensor, "component amplitude"]
) -> _Option:
    """The degree with most evidence, averaged over the widths of its amplitudes.

    Widths go over the rms that the terms have together, from less than the noise to many times as much; the best of them becomes the
    prior. So what is left sets the scale of a correction, which no source knows beforehand (empirical Bayes).
    """
    families, by_degree = [], []
    for degree in _asked(kind.effect.lowest, kind.limit.degree):
        keys = kind.keys(degree)
        relative = torch.tensor([kind.effect.relative_width(d) for d, _ in keys], dtype=torch.float64)
        own = columns[:, : len(keys)] * relative
        scale = float(own.square().sum(1).mean().sqrt())
        families.append(Family.of(kind.cause.label, own))
        by_degree.append((degree, keys, relative / max(scale, 1e-300)))
    evidence = evidence_by_amplitude(fit, families)
    top = int(torch.tensor([log_mean_exp(row) for row in evidence]).argmax())
    degree, keys, per_rms = by_degree[top]
    rms = policy.AMPLITUDES[int(evidence[top].argmax())]
    widths = {key: float(f"{rms * float(w):.3g}") for (_, key), w in zip(keys, per_rms, strict=True)}
    return _Option(kind, start, degree, widths, log_mean_exp(evidence[top]))


def best_corrected(
    extended: Fit, searched: Fit, causes: Fit, unseen: Observations, tell: Callable[[str], None]
) -> Correction:
    """The correction of the extended rig, or of that with all causes that were taken where these are worth it; judged by unseen readings.

    Args:
        extended: With the named causes, fitted to the readings of the search.
        searched: With all causes that were taken, named or not, fitted to the same.
        causes: The extended rig, fitted to the readings that count.
        unseen: Readings that no fit has seen; may be empty.
        tell: Called with a message for each correction that is taken.
    """
    best = corrected(extended, tell)
    if searched.rig.effects != extended.rig.effects:
        other = corrected(searched, tell)
        lead = other.fit.log_evidence - best.fit.log_evidence
        if other.is_taken and (lead > policy.LEAST_LOG_EVIDENCE_CORRECTED or not best.is_taken):
            best = other
    if not best.is_taken:
        return best
    polished = _fitted(best.fit.rig, best.fit, policy.FINE_TOLERANCE)
    best = replace(best, fit=polished, final=polished)
    if causes.observations is not polished.observations:
        rules = polished.posterior.model.rules
        best = replace(best, final=fit_rig(polished.rig, causes.observations, polished.values, rules))
    if not len(unseen):
        return best
    gain = improvement_of(causes, best.final, unseen)
    if gain.is_loss or gain.after.errors.vector_T > gain.before.errors.vector_T:
        return replace(best, gain=gain, refusal="unseen readings are predicted worse with what was tried")
    return replace(best, gain=gain)


def corrected(fit: Fit, tell: Callable[[str], None]) -> Correction:
    """Correct a fit by what has clear evidence and predicts blocks of places held out better, the best first; roughly fitted.

    Args:
        fit: With all causes.
        tell: Called with a message for each correction that is taken.
    """
    block = pose_blocks(fit.observations, np.random.default_rng(0))
    kinds = _kinds(fit)
    limits = {kind.cause.label: kind.limit.words for kind in kinds if kind.limit.words}
    kinds = [kind for kind in kinds if kind.limit.degree >= kind.effect.lowest]
    candidates = [
        _Candidate.at(kind, fit) for kind in kinds
    ]  # columns hardly change as corrections are taken
    parts = list[Part]()
    while candidates and len(parts) < policy.MOST_CORRECTIONS:
        options = [candidate.best_option(fit) for candidate in candidates]
        best = max(options, key=lambda option: option.log_bayes_factor)
        if best.log_bayes_factor <= policy.LEAST_LOG_EVIDENCE_CORRECTED:
            break
        candidates = [candidate for candidate in candidates if candidate.kind is not best.kind]
        rig = best.kind.rig(fit, best.start, best.widths)
        after = _fitted(rig, fit, policy.ROUGH_TOLERANCE)
        gain = held_out(fit, after, block)
        log_bayes_factor = after.log_evidence - fit.log_evidence
        if gain.elpd_difference <= 0.0 or log_bayes_factor <= 0.0:
            continue
        label = best.kind.cause.label
        tell(f"correcting by {label} to degree {best.degree} ({log_bayes_factor:+.1f} in log evidence)")
        parts.append(Part(best.kind.cause, best.degree, len(best.widths), log_bayes_factor, gain))
        fit = after
    refusal = "" if parts else "no correction has clear evidence and predicts places held out better"
    return Correction(fit, tuple(parts), limits, refusal, fit)


def _fitted(rig: Rig, fit: Fit, tolerance: float) -> Fit:
    rules = fit.posterior.model.rules
    return fit_rig(rig, fit.observations, fit.start_with(rig), rules, tolerance=tolerance)


def _kinds(fit: Fit) -> list[_Kind]:
    """Corrections that concern the session and that the rig does not have yet."""
    circumstances = fit.posterior.model.circumstances
    return [
        _Kind(effect, cause, effect.starts(circumstances, place), effect.limit(circumstances, place))
        for effect in EFFECTS.values()
        if isinstance(effect, CorrectionEffect)
        for place in effect.places(fit.rig)
        if (cause := Cause(effect.name, place)) not in fit.rig.corrections
        and effect.concerns(circumstances, place)
    ]


def _asked(lowest: int, highest: int) -> list[int]:
    """Degrees that are asked: each of the low ones, then a fifth more each time, and the highest."""
    degrees, degree = [], lowest
    while degree < highest:
        degrees.append(degree)
        degree += max(1, degree // FRACTION)
    return [*degrees, highest]

"""Kinds of corrections that readings may support, and how well they do: by their evidence in the linear model at a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.linear_fit import density_in_full, full_fit, linear_fit
from estimator.diagnosis.corrections.steps import Starts, log_choices, steps_of
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_mean_exp
from estimator.diagnosis.structure.discrepancy import evidence_by_amplitude
from estimator.diagnosis.structure.families.collection import Family
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.corrections.correction import Correction as CorrectionEffect
from estimator.effects.corrections.correction import Limit
from estimator.effects.stages import MotionEffect, ReadingEffect
from estimator.effects.use import Use, is_in_field
from estimator.geometry.motion import base_from_motion
from estimator.model.measurement_model import MeasurementModel, nominal_tensors
from estimator.model.nominal import gradient_T_per_m
from estimator.rig.coordinates import Values
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig

FRACTION = 5  # of a degree to the next that is asked: between them evidence hardly changes
STEP = 1e-3  # of the typical width of an amplitude, for derivatives; predictions are nearly linear in it


@dataclass(frozen=True)
class CorrectionKind:
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

    def with_at_most(self, n_amplitudes: int) -> CorrectionKind:
        """This kind up to the highest degree with at most so many amplitudes, or up to its lowest."""
        degree = self.limit.degree
        while degree > self.effect.lowest and len(self.keys(degree)) > n_amplitudes:
            degree -= 1
        return replace(self, limit=replace(self.limit, degree=degree))

    def as_predicted(self, rig: Rig) -> CorrectionKind | None:
        """This kind up to the degree to which the field of a single moment has it, as predictions do; None where it has nothing of it."""
        degrees = range(self.effect.lowest, self.limit.degree + 1)
        beyond = [
            degree
            for degree in degrees
            if any(
                self.effect.beyond_the_moment(self.effect.key(degree, t)) for t in self.effect.terms(degree)
            )
        ]
        degree = min(beyond, default=self.limit.degree + 1) - 1
        if degree < self.effect.lowest or not is_in_field(rig, self.cause):
            return None
        return replace(self, limit=replace(self.limit, degree=degree))

    def rig(self, fit: Fit, start: dict[str, float], widths: dict[str, float], is_free: bool = True) -> Rig:
        """The rig with amplitudes at zero and priors of these widths."""
        zeros = dict.fromkeys(widths, 0.0)
        circumstances = fit.posterior.model.circumstances
        rig = with_effect(fit.rig, self.cause, fit.observations, {**start, **zeros}, is_free, circumstances)
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
        if len(starts) > 1:
            factors = self.effect.factors(fit.posterior.model.circumstances, self.cause.place, starts)
            if factors is not None:
                reading = torch.arange(len(fit.observations), device=factors.device)[:, None].expand(-1, 3)
                of_component = factors[:, reading[fit.observations.is_measured]]
                return (of_component[:, None] * self.columns(fit, starts[:1], degree).mT).mT
        step = STEP * self.effect.typical_width(fit.posterior.model.circumstances.extent)
        keys = [key for _, key in self.keys(degree)]
        n = len(starts) * len(keys)
        rig = self.rig(fit, starts[0], dict.fromkeys(keys, 1.0), is_free=False)
        model = MeasurementModel.unruled(rig, fit.observations).with_rules(fit.posterior.model.rules)
        each = fit.vector.new_full((len(keys),), step).diag().repeat(len(starts), 1)
        values = nominal_tensors(rig, fit.vector)
        values |= fit.values | {f"{self.cause.label}.{key}": each[:, i] for i, key in enumerate(keys)}
        if len(starts) > 1:
            for key in starts[0]:
                shapes = fit.vector.new_tensor([start[key] for start in starts])
                values[f"{self.cause.label}.{key}"] = shapes.repeat_interleave(len(keys))
        with torch.no_grad():
            # Many poses, each near the reported one.
            if len(starts) > 1 and isinstance(self.effect, MotionEffect):
                change_T = fit.posterior.measured_components(self._shifted_T(fit, model, values))
            else:
                is_shown = isinstance(self.effect, ReadingEffect)  # the field at the sensors stays
                field_T = fit.at_sensor_T if is_shown else model.at_sensor_T(values)
                reading_T = model.shown_T(values, field_T).expand(n, len(fit.observations), 3)
                change_T = fit.posterior.measured_components(reading_T) - fit.predicted_T
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
class CorrectionOption:
    """One kind up to one degree, with the widths of its amplitudes that have most evidence.

    Attributes:
        columns_T: Change of the measured components per unit of each amplitude.
    """

    kind: CorrectionKind
    start: dict[str, float]
    degree: int
    widths: dict[str, float]
    columns_T: Float[Tensor, "component amplitude"]
    log_bayes_factor: float

    def fitted(self, fit: Fit) -> Fit:
        """A fit with this correction as well, in the linear model.

        In full where that does not hold, so that the full model is no more probable there; and with a frequency, which moves off its grid.
        """
        rig = self.kind.rig(fit, self.start, self.widths)
        names = [f"{self.kind.cause.label}.{key}" for key in self.widths]
        linear = linear_fit(fit, rig, dict(zip(names, self.columns_T.unbind(1), strict=True)))
        has_frequency = len(rig.free) > len(fit.rig.free) + len(names)
        if has_frequency or density_in_full(linear) <= density_in_full(fit):
            return full_fit(linear, fit, policy.ROUGH_TOLERANCE)
        return linear


@dataclass(frozen=True)
class CorrectionCandidate:
    """A kind, with the columns of its amplitudes at the fit that was first.

    Attributes:
        columns: By start: of all degrees where there is one start, else of the lowest.
        of_all_degrees: The others, of starts that were best once.
    """

    kind: CorrectionKind
    first: Fit
    columns: Float[Tensor, "start component amplitude"]
    of_all_degrees: dict[int, Float[Tensor, "component amplitude"]] = field(default_factory=dict)

    @classmethod
    def at(cls, kind: CorrectionKind, fit: Fit) -> CorrectionCandidate:
        """Candidate of a kind of correction, with its columns at a fit."""
        degree = kind.limit.degree if len(kind.starts) == 1 else kind.effect.lowest
        return cls(kind, fit, kind.columns(fit, kind.starts, degree))

    @property
    def as_predicted(self) -> CorrectionCandidate | None:
        """This candidate as far as predictions have it; None where they have nothing of it."""
        kind = self.kind.as_predicted(self.first.rig)
        return None if kind is None else replace(self, kind=kind)

    def best_option(self, fit: Fit) -> CorrectionOption:
        """The start, degree and width with most evidence in the residual of a fit; the evidence is averaged over starts and widths."""
        weight = fit.weight_over(self.first)[:, None]
        if len(self.kind.starts) == 1:
            return _best_degree(fit, self.kind, self.kind.starts[0], self.columns[0] * weight)
        if self.kind.effect.is_stepwise:
            return _best_steps(fit, self.kind, self.columns * weight)
        by_start = Starts.of(fit, self.columns * weight).evidence_beside([])
        top = int(by_start.argmax())
        if top not in self.of_all_degrees:
            start = [self.kind.starts[top]]
            self.of_all_degrees[top] = self.kind.columns(self.first, start, self.kind.limit.degree)[0]
        option = _best_degree(fit, self.kind, self.kind.starts[top], self.of_all_degrees[top] * weight)
        lost = float(by_start.max()) - log_mean_exp(by_start)
        return replace(option, log_bayes_factor=option.log_bayes_factor - lost)


def _best_steps(
    fit: Fit, kind: CorrectionKind, columns: Float[Tensor, "start component amplitude"]
) -> CorrectionOption:
    """The steps with most evidence, and the widths of their amplitudes."""
    rows = steps_of(fit, columns, kind.limit.degree)
    start = {f"since{i}_h": kind.starts[row]["since1_h"] for i, row in enumerate(rows, start=1)}
    together = columns[rows].transpose(0, 1).flatten(1)
    option = _best_degree(fit, kind, start, together, is_all=True)
    return replace(option, log_bayes_factor=option.log_bayes_factor - log_choices(len(columns), len(rows)))


def _best_degree(
    fit: Fit,
    kind: CorrectionKind,
    start: dict[str, float],
    columns: Float[Tensor, "component amplitude"],
    is_all: bool = False,
) -> CorrectionOption:
    """The degree with most evidence, averaged over the widths of its amplitudes.

    Widths go over the rms that the terms have together, from less than the noise to many times as much; the best of them becomes the
    prior. So what is left sets the scale of a correction, which no source knows beforehand (empirical Bayes).
    """
    families, by_degree = [], []
    highest = columns.shape[1] // len(kind.effect.terms(1)) if is_all else kind.limit.degree
    for degree in [highest] if is_all else _asked(kind.effect.lowest, highest):
        keys = kind.keys(degree)
        relative = columns.new_tensor([kind.effect.relative_width(d) for d, _ in keys])
        own = columns[:, : len(keys)] * relative
        scale = float(own.square().sum(1).mean().sqrt())
        families.append(Family.of(kind.cause.label, own))
        by_degree.append((degree, keys, relative / max(scale, 1e-300)))
    evidence = evidence_by_amplitude(fit, families)
    top = int(torch.tensor([log_mean_exp(row) for row in evidence]).argmax())
    degree, keys, per_rms = by_degree[top]
    rms = policy.AMPLITUDES[int(evidence[top].argmax())]
    widths = {key: float(f"{rms * float(w):.3g}") for (_, key), w in zip(keys, per_rms, strict=True)}
    columns_T = columns[:, : len(keys)] / fit.whitening_per_T[:, None]
    return CorrectionOption(kind, start, degree, widths, columns_T, log_mean_exp(evidence[top]))


def kinds_of(fit: Fit) -> list[CorrectionKind]:
    """Corrections that concern the session and that the rig does not have yet."""
    circumstances = fit.posterior.model.circumstances
    return [
        CorrectionKind(effect, cause, effect.starts(circumstances, place), effect.limit(circumstances, place))
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

"""Kinds of corrections that readings may support, and what each changes in the predictions of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.corrections.correction import Correction as CorrectionEffect
from estimator.effects.corrections.correction import Limit
from estimator.effects.stages import MotionEffect, ReadingEffect
from estimator.effects.use import Use, is_in_field
from estimator.geometry.motion import base_from_motion
from estimator.model.measurement_model import MeasurementModel
from estimator.model.nominal import gradient_T_per_m
from estimator.rig.coordinates import Values, nominal_tensors
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig

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

    @property
    def lowest(self) -> int:
        """Lowest degree that is asked for."""
        return max(self.effect.lowest, self.effect.asked_from)

    def keys(self, degree: int) -> list[tuple[int, str]]:
        """Degree and key of each amplitude up to a degree."""
        degrees = range(self.lowest, degree + 1)
        return [(d, self.effect.key(d, term)) for d in degrees for term in self.effect.terms(d)]

    def as_predicted(self, rig: Rig) -> CorrectionKind | None:
        """This kind up to the degree to which the field of a single moment has it, as predictions do; None where it has nothing of it."""
        degrees = range(self.lowest, self.limit.degree + 1)
        beyond = [
            degree
            for degree in degrees
            if any(
                self.effect.beyond_the_moment(self.effect.key(degree, t)) for t in self.effect.terms(degree)
            )
        ]
        degree = min(beyond, default=self.limit.degree + 1) - 1
        if degree < self.lowest or not is_in_field(rig, self.cause):
            return None
        return replace(self, limit=replace(self.limit, degree=degree))

    def rig(
        self,
        fit: Fit,
        start: dict[str, float],
        widths: dict[str, float],
        is_free: bool = True,
        of: Rig | None = None,
    ) -> Rig:
        """A rig, by default that of a fit, with amplitudes at zero and priors of these widths."""
        zeros = dict.fromkeys(widths, 0.0)
        circumstances = fit.circumstances
        rig = with_effect(
            of or fit.rig, self.cause, fit.observations, {**start, **zeros}, is_free, circumstances
        )
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
            factors = self.effect.factors(fit.circumstances, self.cause.place, starts)
            if factors is not None:
                reading = torch.arange(len(fit.observations), device=factors.device)[:, None].expand(-1, 3)
                of_component = factors[:, reading[fit.observations.is_measured]]
                return (of_component[:, None] * self.columns(fit, starts[:1], degree).mT).mT
        step = STEP * self.effect.typical_width(fit.circumstances.extent)
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
        changes = change_T * fit.whitening_per_T / step
        return changes.unflatten(0, (len(starts), len(keys))).mT

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


def kinds_of(fit: Fit) -> list[CorrectionKind]:
    """Corrections that concern the session and that the rig does not have yet."""
    circumstances = fit.circumstances
    return [
        CorrectionKind(effect, cause, effect.starts(circumstances, place), effect.limit(circumstances, place))
        for effect in EFFECTS.values()
        if isinstance(effect, CorrectionEffect)
        for place in effect.places(fit.rig)
        if (cause := Cause(effect.name, place)) not in fit.rig.corrections
        and effect.concerns(circumstances, place)
    ]

"""The fit about which readings count as linear in all that may be wrong: with the leading causes, beside the leading departures."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.linear import Projector
from estimator.diagnosis.mixture.following import limiting
from estimator.diagnosis.mixture.items import Dictionary, Item
from estimator.diagnosis.mixture.listed import Start
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.use import as_meant
from estimator.rig.parameters import LogNormal, Parameter
from estimator.rig.rig import Cause, Rig

LEAST_POSITIVE = 0.1  # of its usual value: where a fit of a positive quantity starts at least
CERTAIN = 1e3  # log prior of what is there in every set
LEAST_CHANGE = 1e-3  # of all readings together, over their noise, by a cause that a fit has
LARGE = 1.0  # stated widths from which on a size may be in the tail of its prior
NEAR_A_BOUND = 0.01  # standard deviations of a prior from its bound, within which no fit starts


@dataclass(frozen=True)
class Expansion:
    """A fit about which the readings are linear.

    Attributes:
        plain: Of the rig as described.
        fit: With the causes that lead, to the readings without the departures that lead.
        departed_T: What these departures change in the measured components.
        log_prior: Of each of these causes at its start, within the listed ones.
        factors: On the stated widths of these causes' sizes, where a fit has found them far beyond.
    """

    plain: Fit
    fit: Fit
    departed_T: Float[Tensor, " component"]
    log_prior: Mapping[Cause, float]
    factors: Mapping[Cause, float] = field(default_factory=dict)

    @classmethod
    def of(cls, plain: Fit) -> Expansion:
        """About the rig as described."""
        return cls(plain, plain, torch.zeros_like(plain.predicted_T), {})

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Causes that the fit has beyond the rig as described."""
        return tuple(cause for cause in self.fit.rig.effects if cause not in self.plain.rig.effects)

    @cached_property
    def _own(self) -> dict[Cause, list[int]]:
        """Coordinates of each of these causes."""
        names = self.fit.posterior.coordinates.names
        return {c: [i for i, name in enumerate(names) if name.startswith(f"{c.label}.")] for c in self.causes}

    @cached_property
    def _base(self) -> list[int]:
        """Coordinates of the rig as described."""
        own = {i for rows in self._own.values() for i in rows}
        return [i for i in range(self.fit.posterior.coordinates.n) if i not in own]

    @cached_property
    def prior_precision(self) -> Float[Tensor, "parameter parameter"]:
        """Prior precision of the numbers of the rig as described."""
        prior = (self.fit.optimum.precision - self.fit.optimum.information)[0]
        return prior[self._base][:, self._base]

    @cached_property
    def always(self) -> Projector:
        """Removes what these numbers can follow."""
        return Projector.of(self.fit.jacobian[:, self._base], self.prior_precision)

    @property
    def names(self) -> tuple[str, ...]:
        """Coordinates of the rig as described, by name."""
        return tuple(self.fit.posterior.coordinates.names[i] for i in self._base)

    @property
    def keys(self) -> list[tuple[str, str]]:
        """Name and label of each of these coordinates, which tell them from all others."""
        coordinates = self.fit.posterior.coordinates
        return [(coordinates.names[i], coordinates.labels[i]) for i in self._base]

    @property
    def prior_mean(self) -> Float[Tensor, " parameter"]:
        """Their prior means."""
        return self.fit.vector[self._base] - self._pulled

    @cached_property
    def residual(self) -> Float[Tensor, " component"]:
        """Whitened, without causes and departures and with the rig's numbers at their prior means."""
        pulled = self.always.jacobian @ self._pulled
        without = self.fit.residual + pulled + self.departed_T * self.fit.whitening_per_T
        return without + sum((self._change(cause) for cause in self.causes), torch.zeros_like(without))

    @cached_property
    def _pulled(self) -> Float[Tensor, " parameter"]:
        """How far the readings pull the rig's numbers from their prior means: at the maximum as hard as the priors pull back."""
        pull = self.always.jacobian.T @ self.fit.residual
        return torch.linalg.pinv(self.prior_precision, hermitian=True) @ pull

    def _change(self, cause: Cause) -> Float[Tensor, " component"]:
        """Whitened change of the predictions by a cause, beside the others."""
        fit = self.fit
        without = {**fit.values, **fit.null_values(cause)}
        with torch.no_grad():
            predicted_T = fit.posterior.measured_components(
                fit.posterior.model.predict(without).expand(len(fit.observations), 3)
            )
        return (fit.predicted_T - predicted_T) * fit.whitening_per_T

    @property
    def has_idle(self) -> bool:
        """Whether a cause of the fit changes no reading: a piece of iron of no volume."""
        return any(float(self._change(cause).norm()) < LEAST_CHANGE for cause in self.causes)

    @cached_property
    def alone(self) -> Fit:
        """The fit as if causes and departures were absent, all that the evidence of further columns depends on."""
        return self.fit.to_first_order(self.always, self.always.rest(self.residual))

    @cached_property
    def present(self) -> list[Start]:
        """The causes of the fit: each may still be absent, or have some of its quantities alone.

        Its shift leads from its absence to the fit, in which the columns are taken.
        """
        return [self._present(cause) for cause in self.causes]

    def _present(self, cause: Cause) -> Start:
        fit, rows = self.fit, self._own[cause]
        circumstances = fit.circumstances
        quantities = {q.key: q for q in EFFECTS[cause.name].quantities(circumstances.extent)}
        keys = [fit.posterior.coordinates.names[i].removeprefix(f"{cause.label}.") for i in rows]
        shift = self._change(cause)
        sizes, shapes = list[int](), list[Tensor]()
        for i, key in zip(rows, keys, strict=True):
            quantity, column = quantities[key], fit.jacobian[:, i]
            value = fit.values[f"{cause.label}.{key}"]
            if isinstance(quantity.prior, LogNormal):
                shift = shift - column * torch.log(value / quantity.prior.median)
                shapes.append(column * quantity.prior.relative_sd)
            elif quantity.is_shape:
                shapes.append(column * quantity.prior.sd)
            else:
                shift = shift - column * (value - quantity.null)
                sizes.append(i)
        own = [fit.posterior.coordinates.names[i].removeprefix(f"{cause.label}.") for i in sizes]
        fixed = {
            key: float(fit.values[f"{cause.label}.{key}"]) for key, q in quantities.items() if q.is_shape
        }
        candidate = Candidate(
            cause,
            fixed,
            tuple(own),
            tuple(quantities[key].unit for key in own),
            shift,
            fit.jacobian[:, sizes],
            fit.vector.new_tensor([quantities[key].prior.sd for key in own]),
            tuple(k for k, key in enumerate(own) if quantities[key].prior.lower >= quantities[key].null),
        )
        stacked = torch.stack(shapes, dim=1) if shapes else shift.new_zeros(len(shift), 0)
        # Shapes that are free have the whole width of their prior: they are at no start of several any more.
        n_starts = len(EFFECTS[cause.name].starts(circumstances, cause.place)) if shapes else 1
        certain = CERTAIN if cause in self.limiting else 0.0
        return Start(candidate, self.log_prior[cause] + math.log(n_starts) + certain, stacked)

    @cached_property
    def limiting(self) -> frozenset[Cause]:
        """Causes that are there in every set about this fit: only full fits tell what readings would say without them."""
        return limiting(self.plain, self.fit)

    def moved(
        self, dictionary: Dictionary, chosen: Sequence[int], sizes: Float[Tensor, " column"]
    ) -> Expansion:
        """The expansion about a fit with other causes, beside other departures.

        Args:
            dictionary: At this expansion.
            chosen: The items that lead.
            sizes: Coefficients of their columns, one item after the other.
        """
        items, sizes = dictionary.items, sizes.to(self.residual)
        departed_T, start = torch.zeros_like(self.departed_T), dict[str, Tensor | float]()
        first, log_prior = 0, dict[Cause, float]()
        listed = {items[i].cause: items[i].start for i in chosen if items[i].is_listed}
        rig = self._with(listed, self.factors)
        for i in chosen:
            item = items[i]
            own = sizes[first : first + len(item.columns)]
            first += len(item.columns)
            if item.is_listed:
                start |= self._start(rig, item, own)
                log_prior[item.cause] = self.log_prior.get(item.cause, item.log_prior_of_start)
            else:
                departed_T += dictionary.changed([i], own) / self.fit.whitening_per_T
        readings = self.plain.observations
        if as_meant(
            self.plain.rig, readings
        ).rows_late:  # fields stand beside other rows: nothing is taken away from them
            departed_T = torch.zeros_like(departed_T)
        field_T = readings.field_sensor_T.clone()
        cleaned = readings
        if bool(departed_T.any()):
            field_T[readings.is_measured] -= departed_T
            cleaned = readings.with_field(field_T)
        rules = self.plain.posterior.model.rules
        left = self.residual - dictionary.changed(chosen, sizes)
        fit = fit_rig(rig, cleaned, {**self.fit.values, **start}, rules, other_start=self._moved(left))
        known = {cause: self.factors[cause] for cause in listed if cause in self.factors}
        fit, more = with_tails(
            fit,
            listed.keys() - known.keys(),
            lambda more: self._with(listed, known | more),
        )
        return Expansion(self.plain, fit, departed_T, log_prior, known | more)

    def _moved(self, left: Float[Tensor, " component"]) -> dict[str, Tensor]:
        """The rig's numbers in the linear model, given what the items leave of the readings."""
        always = self.always
        fitted = always.factor @ (always.factor.T @ (always.jacobian.T @ left))
        vector = self.fit.vector[self._base] + fitted - self._pulled
        with torch.no_grad():
            return dict(self.plain.posterior.coordinates.values(vector))

    def _start(self, rig: Rig, item: Item, sizes: Float[Tensor, " column"]) -> dict[str, Tensor | float]:
        """Values of a listed cause in the linear model."""
        names = rig.names_of(item.cause)
        own = {name: rig.parameters[name] for name in names.values()}
        start: dict[str, Tensor | float] = {name: p.value for name, p in own.items()}
        if item.cause in self.causes:
            start |= {name: value for name, value in self.fit.values.items() if name in own}
            start |= self.fit.null_values(item.cause)
        for key, size in zip(item.keys, sizes, strict=False):
            name = names[key]
            start[name] = _inside(own[name], float(start[name]) + float(size))
        return start

    def _with(self, listed: Mapping[Cause, dict[str, float]], factors: Mapping[Cause, float]) -> Rig:
        """The rig as described with causes at their shapes."""
        rig, plain = self.plain.rig, self.plain
        circumstances = plain.circumstances
        for cause, shapes in listed.items():
            factor = factors.get(cause, 1.0)
            rig = with_effect(
                rig, cause, plain.observations, shapes, circumstances=circumstances, factor=factor
            )
        return rig


def with_tails(
    fit: Fit, causes: Collection[Cause], rig_with: Callable[[dict[Cause, float]], Rig]
) -> tuple[Fit, dict[Cause, float]]:
    """A fit, or another one with wider priors of large sizes if that is more probable.

    A fit has one normal prior, and that of a size has tails: a piece of iron twice as large as usual would be put too near.

    Args:
        fit: With priors of the stated widths.
        causes: Whose sizes are looked at.
        rig_with: The rig with factors on the widths of some causes.
    Returns: The more probable fit, and its factors.
    """
    extent = fit.circumstances.extent

    def is_large(cause: Cause) -> bool:
        sizes = [q for q in EFFECTS[cause.name].quantities(extent) if not (q.is_shape or q.is_positive)]
        away = [abs(float(fit.values[f"{cause.label}.{q.key}"]) - q.null) / q.prior.sd for q in sizes]
        return max(away, default=0.0) > LARGE

    factors = {cause: policy.WIDTHS[-1][0] for cause in causes if is_large(cause)}
    if not factors:
        return fit, {}
    rig, least = rig_with(factors), fit.log_evidence - len(factors) * _log_odds_of_widest()
    if fit.foretold(rig).log_evidence < least - policy.CLEAR_LOG_EVIDENCE:
        return fit, {}
    wide = fit_rig(rig, fit.observations, fit.values, fit.posterior.model.rules, near=fit)
    return (wide, factors) if wide.log_evidence > least else (fit, {})


def _log_odds_of_widest() -> float:
    """Log prior odds of the widest factor on a stated width against the likeliest one."""
    shares = [share for _, share in policy.WIDTHS]
    return math.log(shares[-1] / max(shares))


def _inside(parameter: Parameter, value: float) -> float:
    """The nearest value at which a fit may start."""
    if parameter.is_positive:
        return max(value, LEAST_POSITIVE * float(parameter.value))
    if parameter.prior is None:
        return value
    lower, upper, near = parameter.prior.lower, parameter.prior.upper, NEAR_A_BOUND * parameter.prior.sd
    return min(max(value, lower + near), upper - near)

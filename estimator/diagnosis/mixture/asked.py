"""What the readings say of all that may be wrong, at one expansion."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.mixture.departures import Changes
from estimator.diagnosis.mixture.expansion import CERTAIN, Expansion
from estimator.diagnosis.mixture.items import Dictionary
from estimator.diagnosis.mixture.slots import Samples, Slots, Sweeps
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Asked:
    """What the readings say at one expansion.

    Attributes:
        pool: Columns of every listed cause that the expansion lacks.
        changes: Of the readings, about this expansion or one nearby; None once no other expansion is asked from here, for they are large.
    """

    expansion: Expansion
    pool: tuple[Candidate, ...]
    dictionary: Dictionary
    changes: Changes | None
    slots: Slots
    samples: Samples

    @property
    def noise_number(self) -> int:
        """Number of the most frequent factor on the noise of the fit."""
        return max(self.samples.noises, key=self.samples.noises.__getitem__)

    @property
    def noise(self) -> float:
        """The most frequent factor on the noise of the fit."""
        return float(self.slots.grid[self.noise_number])

    @cached_property
    def leading(self) -> tuple[int, ...]:
        """The most probable set of items of those that hold the most probable set of causes and departures."""
        items = self.dictionary.items
        density = {model: self.slots.log_density(model) for model in self.samples.models}
        labels = {model: frozenset(items[i].cause for i in model) for model in density}
        highest, by_labels = max(density.values()), defaultdict[frozenset[Cause], float](float)
        for model, value in density.items():
            by_labels[labels[model]] += math.exp(value - highest)
        most = max(by_labels, key=by_labels.__getitem__)
        return max((model for model in density if labels[model] == most), key=density.__getitem__)

    def causes_of(self, model: Sequence[int]) -> frozenset[Cause]:
        """Listed causes of a set of items."""
        items = [self.dictionary.items[i] for i in model]
        return frozenset(item.cause for item in items if item.is_listed)

    def moved(self, chosen: Sequence[int]) -> Expansion:
        """The expansion about a fit with some items."""
        sizes, _ = self.slots.products.sizes(chosen, self.noise)
        return self.expansion.moved(self.dictionary, chosen, sizes)

    def sizes_of(self, item: int, beside: Sequence[int]) -> Float[Tensor, " column"]:
        """Coefficients of an item's columns, beside others."""
        sizes, _ = self.slots.products.sizes([*beside, item], self.noise)
        return sizes[len(sizes) - len(self.dictionary.items[item].columns) :]

    def new_in(self, model: Sequence[int], known: Collection[Cause] = ()) -> list[int]:
        """Listed items of a set that the expansion lacks, clearest first; without some that are known."""
        causes = (*self.expansion.causes, *known)
        items = self.dictionary.items
        new = [i for i in model if items[i].is_listed and items[i].cause not in causes]
        gain = self.slots.products.gains(model, self.noise) if new else {}
        return sorted(new, key=lambda i: -gain[i])

    def is_worse_than(self, before: Asked, causes: Collection[Cause]) -> bool:
        """Whether the readings are clearly less probable with some causes and departures than before, each about a fit that has its own."""
        items, known = before.dictionary.items, {*before.expansion.causes}
        departed = {items[i].cause for i in before.leading if not items[i].is_listed}
        led = {items[i].cause for i in before.leading}.intersection(known)
        highest = max(before.highest_with(departed | own) for own in (led, known))
        return self.highest_with(causes) < highest - policy.LIKED_BY

    def highest_with(self, causes: Collection[Cause]) -> float:
        """Log density of the readings and the most probable set of items of some causes and departures."""
        numbers = [i for i, item in enumerate(self.dictionary.items) if item.cause in causes]
        chosen, _ = self.slots.among(numbers).climbed()
        return self.log_density_of([numbers[i] for i in chosen if i is not None])

    def without(self, causes: Collection[Cause], seed: int, sweeps: Sweeps) -> Asked:
        """The readings asked again without some causes."""
        items, slots = self.dictionary.items, self.slots
        rows = [i for i, item in enumerate(items) if item.cause in causes]
        if not rows:
            return self
        fewer = Slots(slots.products, slots.noise, slots.n_slots, excluded=[*slots.excluded, *rows])
        allowed = [i for i in self.leading if i not in rows]
        return replace(self, slots=fewer, samples=fewer.sample(sweeps, seed, allowed))

    @property
    def is_fitted(self) -> bool:
        """Whether the expansion has every leading cause, so that none is known from a linear model far from it alone."""
        items = [self.dictionary.items[i] for i in self.leading]
        return all(item.cause in self.expansion.causes for item in items if item.is_listed)

    @cached_property
    def log_density(self) -> float:
        """Log density of the readings and the leading set of items."""
        return self.log_density_of(self.leading)

    def log_density_of(self, model: Sequence[int]) -> float:
        """Log density of the readings and a set of items, up to a constant that all expansions of one session share."""
        fit, always = self.expansion.fit, self.expansion.always
        precision = always.jacobian.T @ always.jacobian + self.expansion.prior_precision
        n_certain = sum(self.dictionary.items[i].cause in self.expansion.limiting for i in model)
        return (
            self.slots.log_density(model)
            - CERTAIN * n_certain
            + float(fit.whitening_per_T.clamp(min=1e-300).log().sum())
            - 0.5 * float(torch.logdet(precision))
        )

"""All causes compared beside those that lead: against nothing, and against something that no list holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.mixture.asked import Asked
from estimator.rig.rig import Cause

NOTHING, UNEXPLAINED = "nothing", "unexplained"


@dataclass(frozen=True)
class Hypothesis:
    """A cause, nothing, or something that no list holds, as the explanation of one thing that is wrong.

    Attributes:
        cause: None for `nothing` and `unexplained`.
        log_bayes_factor: Against nothing, averaged over starts, quantities and widths.
        probability: Among all hypotheses of the comparison.
    """

    cause: Cause | None
    name: str
    log_bayes_factor: float
    probability: float


@dataclass(frozen=True)
class Comparison:
    """All hypotheses beside some items.

    Attributes:
        asked: The readings at one expansion.
        beside: Numbers of the items that are there.
        taken: Stated causes that these hypotheses compete with; none where it is asked what more may be there.
    """

    asked: Asked
    beside: tuple[int, ...]
    taken: tuple[Cause, ...] = ()

    @cached_property
    def _log_bayes_factors(self) -> Float[Tensor, " item"]:
        return self.asked.slots.evidence(self.beside, self.asked.noise_number)

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Most probable first."""
        items, log_prior = self.asked.dictionary.items, self.asked.slots.log_prior
        noise = self.asked.noise_number
        conditional = self.asked.slots.conditional(self.beside, noise)
        rows: dict[Cause | str, list[int]] = {UNEXPLAINED: []}
        for i, item in enumerate(items):
            if log_prior[i] == -math.inf:  # it is not asked any more
                continue
            rows.setdefault(item.cause if item.is_listed else UNEXPLAINED, []).append(i)
        joint = self._log_bayes_factors + log_prior
        hypotheses = [Hypothesis(None, NOTHING, 0.0, float(conditional[-1]))]
        for what, own in rows.items():
            if own:
                value = float(torch.logsumexp(joint[own], 0) - torch.logsumexp(log_prior[own], 0))
                cause = what if isinstance(what, Cause) else None
                name = what.label if isinstance(what, Cause) else what
                hypotheses.append(Hypothesis(cause, name, value, float(conditional[own].sum())))
        return tuple(sorted(hypotheses, key=lambda hypothesis: -hypothesis.probability))

    def log_bayes_factor(self, causes: Sequence[Cause]) -> float:
        """Log Bayes factor of the best item of some causes against nothing."""
        own = [i for i, item in enumerate(self.asked.dictionary.items) if item.cause in causes]
        return float(self._log_bayes_factors[own].max()) if own else 0.0

    def best_item(self, cause: Cause) -> int:
        """The most probable item of a cause, beside the others."""
        return self._best([i for i, item in enumerate(self.asked.dictionary.items) if item.cause == cause])

    @cached_property
    def best_departure(self) -> int | None:
        """The most probable item that no list holds; None where there is none."""
        own = [i for i, item in enumerate(self.asked.dictionary.items) if not item.is_listed]
        return self._best(own) if own else None

    def _best(self, own: Sequence[int]) -> int:
        """The most probable of some items."""
        return own[int((self._log_bayes_factors[own] + self.asked.slots.log_prior[own]).argmax())]

    def change(self, item: int) -> Float[Tensor, " component"]:
        """Whitened change of the predictions by an item, beside the others, less what the rig's numbers can follow."""
        asked = self.asked
        change = asked.dictionary.changed([item], asked.sizes_of(item, self.beside))
        return asked.expansion.always.rest(change)

    def left_sigma(self, item: int | None) -> float:
        """Rms of what is left beside the others and an item, in units of the noise."""
        asked = self.asked
        chosen = [*self.beside, *([] if item is None else [item])]
        sizes, _ = asked.slots.products.sizes(chosen, asked.noise)
        left = asked.dictionary.residual - asked.dictionary.changed(chosen, sizes)
        return float(asked.expansion.always.rest(left).square().mean().sqrt()) / asked.noise


@dataclass(frozen=True)
class Left:
    """Something that no list holds, beside some causes.

    Attributes:
        log_bayes_factor: Of it against nothing.
        words: What describes it best.
        rms_sigma: Rms of that description, less what the rig's numbers can follow, in units of the noise.
    """

    log_bayes_factor: float
    words: str
    rms_sigma: float


def left_beside(comparison: Comparison) -> Left:
    """What no list holds, beside the causes of a comparison."""
    item = comparison.best_departure
    if item is None:
        return Left(0.0, "", 0.0)
    unexplained = next(h for h in comparison.hypotheses if h.name == UNEXPLAINED)
    change = comparison.change(item)
    rms_sigma = float(change.square().mean().sqrt()) / comparison.asked.noise
    link = comparison.asked.dictionary.items[item].link
    return Left(unexplained.log_bayes_factor, link.words, rms_sigma)

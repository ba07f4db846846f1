"""Chooses the steps of a correction: one beside the other, by their evidence in the linear model at a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import TINY, log_bayes_factor_by_width

PATIENCE = 2  # steps that may bring nothing by themselves: what opens and closes needs two


def steps_of(fit: Fit, columns: Float[Tensor, "start component amplitude"], most: int) -> list[int]:
    """Starts of the steps that have most evidence together, in their order; of so many starts any may be one, which costs evidence.

    Each new step is tried at all starts. At the end each is tried again beside the others, for the first ones stood in for several.

    Args:
        fit: Whose residual is asked.
        columns: Of one step at each start, whitened.
        most: Number of steps, at most.
    """
    among = Starts.of(fit, columns)
    chosen: list[int] = []
    best: tuple[float, list[int]] = (-math.inf, [])
    for n in range(1, min(most, len(columns)) + 1):
        row, evidence = among.next_beside(chosen)
        chosen = [*chosen, row]
        value = evidence - log_choices(len(columns), n)
        if value > best[0]:
            best = (value, chosen)
        elif n - len(best[1]) >= PATIENCE:
            break
    chosen = best[1]
    for step in list(chosen):
        others = [other for other in chosen if other != step]
        chosen = [*others, among.next_beside(others)[0]]
    return sorted(chosen)


def log_choices(n: int, k: int) -> float:
    """Logarithm of the number of ways to choose some of many.

    Examples:
        >>> round(math.exp(log_choices(5, 2)))
        10
    """
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


@dataclass(frozen=True)
class Starts:
    """The columns of a kind at each of many starts.

    Attributes:
        own: Inner products of the columns of each after projection.
        score: Inner products with the residual.
        power: Mean over components of the summed squares of its columns.
        rows: The columns one after another, whitened.
        followed: What the parameters of the fit can follow of each, along an orthonormal basis.
    """

    fit: Fit
    own: Float[Tensor, "start amplitude amplitude"]
    score: Float[Tensor, "start amplitude"]
    power: Float[Tensor, " start"]
    rows: Float[Tensor, "column component"]
    followed: Float[Tensor, "column parameter"]

    @classmethod
    def of(cls, fit: Fit, columns: Float[Tensor, "start component amplitude"]) -> Starts:
        """All of them, at a fit; quickest where the components of each column lie side by side."""
        n, n_components, width = columns.shape
        rows = columns.mT.flatten(0, 1)
        followed = rows @ fit.projector.basis
        each = followed.unflatten(0, (n, width))
        squares = columns.mT @ columns
        power = torch.diagonal(squares, dim1=1, dim2=2).sum(1) / n_components
        score = (rows @ fit.residual).unflatten(0, (n, width))
        return cls(fit, squares - each @ each.mT, score, power, rows, followed)

    def next_beside(self, chosen: list[int]) -> tuple[int, float]:
        """The start that has most evidence beside those that were chosen, and the evidence of all, averaged over amplitudes."""
        mean = self.evidence_beside(chosen)
        mean[chosen] = -math.inf
        row = int(mean.argmax())
        return row, float(mean[row])

    def evidence_beside(self, chosen: list[int]) -> Float[Tensor, " start"]:
        """Evidence of each start together with those that were chosen, averaged over amplitudes."""
        n, width = self.score.shape
        n_beside = len(chosen) * width
        gram = self.own.new_empty(n, n_beside + width, n_beside + width)
        gram[:, n_beside:, n_beside:] = self.own
        if chosen:
            beside, followed = (
                vectors.unflatten(0, (n, width))[chosen].flatten(0, 1)
                for vectors in (self.rows, self.followed)
            )
            cross = (self.rows @ beside.T - self.followed @ followed.T).unflatten(0, (n, width))
            gram[:, :n_beside, :n_beside] = beside @ beside.T - followed @ followed.T
            gram[:, n_beside:, :n_beside], gram[:, :n_beside, n_beside:] = cross, cross.mT
        score = torch.cat((self.score[chosen].flatten().expand(n, -1), self.score), dim=1)
        power = self.power[chosen].sum() + self.power
        sd = power.new_tensor(policy.AMPLITUDES) / power[:, None].clamp(min=TINY).sqrt()
        evidence = log_bayes_factor_by_width(gram, score, sd, self.fit.free_noise)
        mean: Tensor = torch.logsumexp(evidence, 1) - math.log(sd.shape[1])
        return mean

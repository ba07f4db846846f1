"""Causes that explain readings equally well, and how much stops are expected to tell them apart.

It is a diagnosis in the linear model, after every stop. Each quantity of an ordinary cause is a hypothesis beside the parameters of the
fit. Where one is there for certain, the credible set are the causes that together hold 95 % of the probability. If one of them is right
at the size that the readings give it, a rival that is fitted in its place leaves something of its change. Half the square of that is the
expected log evidence between both, as in `estimator.diagnosis.next_readings`; the least one of all pairs counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.diagnosis.next_readings.stops import lowered
from estimator.diagnosis.policy import ALTERNATIVE, CLEAR_LOG_EVIDENCE
from estimator.planning.so_far import Products, SoFar
from estimator.planning.unseen import SURE, Unseen

MOST_RIVALS = 4  # the most probable ones: each pair takes 3 ms for 2000 candidates
MOST_GROWTH = 3.0  # so many times the stops so far may be spent on it
ENOUGH = 2.0 * CLEAR_LOG_EVIDENCE  # expected: readings that have not told both apart by then will not


def credible(unseen: Unseen, causes: Sequence[str]) -> list[int]:
    """Numbers of the leading quantities of the causes in the credible set; empty unless one is there for certain.

    Args:
        unseen: Quantities as the readings judge them.
        causes: The cause of each.
    """
    if not len(causes) or not bool((unseen.probability > SURE).any()):
        return []
    share = torch.softmax(unseen.log_evidence, dim=0)
    leading: dict[str, int] = {}
    held: dict[str, float] = {}
    for number in share.argsort(descending=True).tolist():
        leading.setdefault(causes[number], number)
        held[causes[number]] = held.get(causes[number], 0.0) + float(share[number])
    result, total = [], 0.0
    for cause in sorted(held, key=lambda cause: -held[cause]):
        if total >= 1.0 - ALTERNATIVE:
            break
        result.append(leading[cause])
        total += held[cause]
    return result[:MOST_RIVALS]


@dataclass(frozen=True)
class Split:
    """Causes that are to be told apart.

    Attributes:
        names: Their leading quantities, the most probable one first.
        sizes: These, as the readings give them.
        places: Their columns.
        own: Columns of the parameters of the fit.
        prior: Precision of each column's prior.
        precision: Of all columns, given the readings, at each draw.
        columns: Derivatives of the readings of each candidate, over their noise.
    """

    names: tuple[str, ...]
    sizes: tuple[float, ...]
    places: tuple[int, ...]
    own: Int[Tensor, " own"]
    prior: Float[Tensor, " all"]
    precision: Float[Tensor, "draw all all"]
    columns: Float[Tensor, "draw stop row all"]

    @classmethod
    def of(cls, so_far: SoFar, products: Products, unseen: Unseen) -> Split | None:
        """What is to be told apart after the readings so far; None where nothing is, or no stops are expected to.

        Args:
            so_far: The readings.
            products: These to first order about the estimate.
            unseen: Quantities as they judge them.
        """
        asked = (~so_far.own).nonzero().flatten()[so_far.model.is_asked]
        names = [so_far.coordinates.names[i] for i in so_far.known[asked].tolist()]
        rivals = credible(unseen, [name.rpartition(".")[0] for name in names])
        if len(rivals) < 2:
            return None
        split = cls(
            tuple(names[i] for i in rivals),
            tuple(unseen.size[rivals].tolist()),
            tuple(asked[rivals].tolist()),
            so_far.own.nonzero().flatten(),
            products.prior.diagonal(),
            products.precision_of_draws,
            so_far.model.every.columns,
        )
        n = len(so_far.entries)
        return split if split.is_open(min(MOST_GROWTH * n, so_far.most_stops - n)) else None

    @cached_property
    def evidence(self) -> tuple[float, Float[Tensor, " stop"]]:
        """Expected log evidence of the pair that is told apart least: now, and after each of the candidates."""
        now, after = [], []
        for right, size in zip(self.places, self.sizes, strict=True):
            for rival in self.places:
                if rival != right:
                    before, with_each = self._of_pair(right, rival, size)
                    now.append(before)
                    after.append(with_each)
        return float(torch.stack(now).min()), torch.stack(after).amin(0)

    @property
    def gains(self) -> Float[Tensor, " stop"]:
        """How much each candidate adds to the least expected log evidence."""
        now, after = self.evidence
        return after - now

    def _of_pair(
        self, right: int, rival: int, size: float
    ) -> tuple[Float[Tensor, ""], Float[Tensor, " stop"]]:
        """Expected log evidence where one cause is right and another is fitted in its place, as a mean over the draws."""
        chosen = torch.cat((self.own, torch.tensor([rival, right])))
        covariance = torch.linalg.inv(self.precision[:, chosen][..., chosen])
        is_right = torch.zeros(len(covariance), 1, len(chosen)).to(covariance)
        is_right[..., -1] = 1.0
        variance = covariance[:, -1, -1]
        less = lowered(covariance, self.columns[..., chosen], is_right)

        def expected(left: Tensor) -> Tensor:
            return 0.5 * size**2 * (1.0 / left - self.prior[right]).mean(0)

        return expected(variance), expected(variance[:, None] - less)

    def is_open(self, n_visits: float) -> bool:
        """Whether so many visits to the best candidate would tell all pairs apart, and those so far were not expected to have."""
        now = self.evidence[0]  # to which each further visit adds no more than the first one
        return now < ENOUGH and now + n_visits * float(self.gains.max()) > CLEAR_LOG_EVIDENCE

"""The rig's numbers as the mixture has them: a mixture over all sets of items that were drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.answer import Answer


@dataclass(frozen=True)
class Numbers:
    """Coordinates of the rig as described.

    Attributes:
        names: Of the coordinates.
        mean, covariance: Over all sets of items, with all readings and with halves of them.
    """

    names: tuple[str, ...]
    mean: Float[Tensor, " coordinate"]
    covariance: Float[Tensor, "coordinate coordinate"]

    @classmethod
    def of(cls, answer: Answer) -> Numbers:
        """The numbers in the linear model about the expansion that counts, each set as probable as it was drawn."""
        asked, models = answer.asked, answer.both.models
        total = sum(models.values())
        each = [_beside(answer, model) for model in models]
        weight = torch.tensor([n / total for n in models.values()], dtype=torch.float64)
        means, covariances = (torch.stack([of_model[k] for of_model in each]) for k in (0, 1))
        mean = weight @ means
        apart = means - mean
        covariance = torch.einsum("m,mij->ij", weight, covariances) + (apart.T * weight) @ apart
        return cls(asked.expansion.names, mean, covariance)

    def about(self, fit: Fit) -> Float[Tensor, "coordinate coordinate"]:
        """Mean square distance from the numbers of a fit."""
        rows = [fit.posterior.coordinates.names.index(name) for name in self.names]
        apart = self.mean - fit.vector[rows]
        return self.covariance + torch.outer(apart, apart)


def _beside(answer: Answer, model: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Mean and covariance of the rig's coordinates beside some items."""
    asked = answer.asked
    dictionary, expansion = asked.dictionary, asked.expansion
    sizes, spread = asked.slots.products.sizes(model, asked.noise)
    columns = dictionary.columns[:, [column for i in model for column in dictionary.items[i].columns]]
    left = dictionary.residual - dictionary.changed(model, sizes)
    own = expansion.always.factor @ expansion.always.factor.T
    following = own @ (expansion.always.jacobian.T @ columns)
    mean = expansion.prior_mean + own @ (expansion.always.jacobian.T @ left)
    return mean, own * asked.noise**2 + following @ spread @ following.T

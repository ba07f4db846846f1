"""Evidence of items beside others in the linear model, with all sizes integrated out: it depends on inner products alone."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.linear import Projector
from estimator.diagnosis.mixture.evidence_kernel import RIDGE, log_bayes_factors
from estimator.diagnosis.mixture.items import Dictionary, Item, renumbered
from estimator.inference.positive_definite import lower_factor


class Products:
    """Inner products, after projection, of all columns of a dictionary, an empty column, and last the residual.

    Args:
        dictionary: The items.
        weight: Of each component, such as 0 for those that are left out; 1 by default.
    """

    def __init__(self, dictionary: Dictionary, weight: Float[Tensor, " component"] | None = None) -> None:
        residual = dictionary.residual[:, None]
        vectors = torch.cat((dictionary.columns, torch.zeros_like(residual), residual), dim=1)
        always, n = dictionary.always, float(len(vectors))
        if weight is not None:
            weight = weight.to(vectors)
            vectors, n = vectors * weight[:, None], float(weight.square().sum())
            always = Projector.of(always.jacobian * weight[:, None], dictionary.prior_precision)
        followed = always.basis.T @ vectors
        self.gram = (vectors.T @ vectors - followed.T @ followed).cpu().contiguous()
        self.n = n - always.jacobian.shape[1]
        self._lay_out(dictionary.items)

    def among(self, numbers: Sequence[int]) -> Products:
        """Inner products for some of the items alone, which are numbered anew."""
        items, columns = renumbered(self.items, numbers)
        rows = torch.tensor([*columns, self.empty, self.residual])
        few = copy(self)
        few.gram = self.gram[rows][:, rows].contiguous()
        few._lay_out(items)
        return few

    def _lay_out(self, items: Sequence[Item]) -> None:
        """Note where the columns of each item are, as machine code reads it."""
        self.items = tuple(items)
        self.empty, self.residual = len(self.gram) - 2, len(self.gram) - 1
        self._begin = np.cumsum([0, *(len(item.columns) for item in items)])
        self._columns = np.array([column for item in items for column in item.columns], dtype=np.int64)
        self._widths = np.array([width for item in items for width in item.widths], dtype=float)
        self._shifts = np.array([self._shift(item) for item in items], dtype=np.int64)
        self._is_one_sided = np.array([item.is_one_sided for item in items], dtype=bool)
        before = [None, *items][: len(items)]
        self._is_like_before = np.array(
            [
                last is not None and (last.columns, last.shift) == (item.columns, item.shift)
                for last, item in zip(before, items, strict=True)
            ],
            dtype=bool,
        )

    def _shift(self, item: Item) -> int:
        return self.empty if item.shift is None else item.shift

    def of(self, chosen: Sequence[int]) -> tuple[Tensor, Tensor, Tensor]:
        """Numbers and widths of the columns of some items, and how the residual is made of columns once their starts are there."""
        columns = [column for i in chosen for column in self.items[i].columns]
        widths = [width for i in chosen for width in self.items[i].widths]
        mixture = self.gram.new_zeros(len(self.gram))
        mixture[self.residual] = 1.0
        for i in chosen:
            mixture[self._shift(self.items[i])] -= 1.0
        return torch.tensor(columns, dtype=torch.long), self.gram.new_tensor(widths), mixture

    def signal_of(self, items: Sequence[int], sizes: Float[Tensor, " size"]) -> Float[Tensor, " column"]:
        """What some items change in the readings, as a combination of columns.

        Args:
            items: Their numbers.
            sizes: Coefficients of their columns, one item after the other.
        """
        columns, _, without = self.of(items)
        signal = -without
        signal[self.residual] = 0.0
        return signal.index_add(0, columns, sizes)

    def beside(
        self, chosen: Sequence[int], noise: float, signal: Float[Tensor, " column"] | None = None
    ) -> Float[Tensor, " item"]:
        """Log Bayes factor of each item beside some others, against these alone.

        Args:
            chosen: The others.
            noise: Factor on the noise of the fit.
            signal: Combination of columns that stands for the residual, where something else than what was measured is asked about.
        """
        columns, widths, mixture = self.of(chosen)
        if signal is not None:
            mixture = mixture + signal
            mixture[self.residual] = 0.0
        score = self.gram @ mixture / noise**2
        followed, reached = self._followed(columns, widths, score, noise)
        score = score - followed.T @ reached
        result = np.empty(len(self.items))
        log_bayes_factors(
            self.gram.numpy(),
            followed.T.contiguous().numpy(),
            score.numpy(),
            self._begin,
            self._columns,
            self._widths,
            self._shifts,
            self._is_one_sided,
            self._is_like_before,
            1.0 / noise**2,
            result,
        )
        return torch.from_numpy(result)

    def of_one(self, item: int, others: Sequence[int], noise: float) -> float:
        """Log Bayes factor of one item beside some others, against these alone."""
        return float(self.among([*others, item]).beside(range(len(others)), noise)[-1])

    def _followed(
        self, columns: Tensor, widths: Tensor, score: Tensor, noise: float
    ) -> tuple[Tensor, Tensor]:
        """What the chosen items can follow of every column, along orthonormal directions, and of the residual."""
        if not len(columns):
            return score.new_zeros(0, len(score)), score.new_zeros(0)
        own = self.gram[columns][:, columns] * widths[:, None] * widths / noise**2
        factor = lower_factor(_with_unit_prior(own))
        both = torch.cat((self.gram[columns] / noise**2, score[columns][:, None]), dim=1) * widths[:, None]
        followed = torch.linalg.solve_triangular(factor, both, upper=False)
        return followed[:, :-1], followed[:, -1]

    def sizes(self, chosen: Sequence[int], noise: float) -> tuple[Tensor, Tensor]:
        """Mean and covariance of the coefficients of some items' columns, one item after the other."""
        columns, widths, mixture = self.of(chosen)
        own = self.gram[columns][:, columns] * widths[:, None] * widths / noise**2
        score = widths * (self.gram[columns] @ mixture) / noise**2
        factor = lower_factor(_with_unit_prior(own))
        mean = widths * torch.cholesky_solve(score[:, None], factor)[:, 0]
        covariance = torch.cholesky_inverse(factor) * widths[:, None] * widths
        return mean, covariance

    def log_likelihood(
        self, chosen: Sequence[int], noise: Float[Tensor, " noise"]
    ) -> Float[Tensor, " noise"]:
        """Log density of the readings with some items, by the factor on the noise, up to a constant."""
        columns, widths, mixture = self.of(chosen)
        square = mixture @ self.gram @ mixture
        variance = noise.square()
        result = -self.n * noise.log() - 0.5 * square / variance
        if not len(columns):
            return result
        own = self.gram[columns][:, columns] * widths[:, None] * widths
        size, vectors = torch.linalg.eigh(own)
        size = size.clamp(min=0.0)
        reached = (vectors.T @ (widths * (self.gram[columns] @ mixture))).square()
        explained = reached / variance[:, None] / (variance[:, None] + size)
        likelihood: Tensor = result + 0.5 * (explained - torch.log1p(size / variance[:, None])).sum(1)
        return likelihood


def _with_unit_prior(gram: Float[Tensor, "*batch column column"]) -> Float[Tensor, "*batch column column"]:
    """Precision of coefficients with standard normal priors."""
    diagonal = torch.diagonal(gram, dim1=-2, dim2=-1)
    precision: Tensor = gram + torch.diag_embed(1.0 + RIDGE * diagonal.abs())
    return precision

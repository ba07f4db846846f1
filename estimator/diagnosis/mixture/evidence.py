"""Evidence of items beside others in the linear model, with all sizes integrated out: it depends on inner products alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.linear import Projector
from estimator.diagnosis.mixture.items import Dictionary, Item
from estimator.inference.positive_definite import lower_factor

RIDGE = 1e-10  # of the square of a column: what rounding leaves of those that the rig's numbers follow
SMALL = 4  # number of columns below which none are added


@dataclass(frozen=True)
class Alike:
    """Items with equally many columns, whose evidence is computed at once.

    Attributes:
        members: Their numbers.
        columns: Of each.
        widths: Prior standard deviations.
        shift: Column of each by which its start changes the predictions; the last, empty one where it does not.
    """

    members: Tensor
    columns: Tensor
    widths: Float[Tensor, "item column"]
    shift: Tensor
    gram: Float[Tensor, "item column column"]
    is_one_sided: Tensor


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
            vectors, n = vectors * weight[:, None], float(weight.square().sum())
            always = Projector.of(always.jacobian * weight[:, None], dictionary.prior_precision)
        followed = always.basis.T @ vectors
        self.gram = vectors.T @ vectors - followed.T @ followed
        self.items = dictionary.items
        self.n = n - always.jacobian.shape[1]
        self.empty, self.residual = len(self.gram) - 2, len(self.gram) - 1
        self.groups = self._groups()

    def _groups(self) -> list[Alike]:
        by_size: dict[int, list[int]] = {}
        for i, item in enumerate(self.items):
            by_size.setdefault(_padded(len(item.columns)), []).append(i)
        groups = []
        for size, members in by_size.items():
            lack = {i: size - len(self.items[i].columns) for i in members}
            columns = torch.tensor([(*self.items[i].columns, *[self.empty] * lack[i]) for i in members])
            widths = self.gram.new_tensor([(*self.items[i].widths, *[0.0] * lack[i]) for i in members])
            shift = torch.tensor([self._shift(self.items[i]) for i in members])
            gram = (
                self.gram[columns[:, :, None], columns[:, None, :]] * widths[:, :, None] * widths[:, None, :]
            )
            one_sided = torch.tensor([self.items[i].is_one_sided for i in members])
            groups.append(Alike(torch.tensor(members), columns, widths, shift, gram, one_sided))
        return groups

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

    def beside(self, chosen: Sequence[int], noise: float) -> Float[Tensor, " item"]:
        """Log Bayes factor of each item beside some others, against these alone.

        Args:
            chosen: The others.
            noise: Factor on the noise of the fit.
        """
        columns, widths, mixture = self.of(chosen)
        score = self.gram @ mixture / noise**2
        followed, reached = self._followed(columns, widths, score, noise)
        score = score - followed.T @ reached
        result = self.gram.new_zeros(len(self.items))
        for alike in self.groups:
            result[alike.members] = self._of_alike(alike, followed, score, noise)
        return result

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

    def _of_alike(self, alike: Alike, followed: Tensor, score: Tensor, noise: float) -> Tensor:
        gram = alike.gram / noise**2
        own_score = score[alike.columns]
        at_start = self.gram[alike.columns, alike.shift[:, None]] / noise**2
        square = torch.diagonal(self.gram)[alike.shift] / noise**2
        if len(followed):
            beside = followed[:, alike.columns.flatten()].unflatten(1, alike.columns.shape)
            scaled = (beside * alike.widths).movedim(1, 0)
            gram = gram - scaled.mT @ scaled
            shifted = followed[:, alike.shift]
            at_start = at_start - torch.einsum("rim,ri->im", beside, shifted)
            square = square - shifted.square().sum(0)
        own_score = (own_score - at_start) * alike.widths
        factor, failed = torch.linalg.cholesky_ex(_with_unit_prior(gram))
        explained = (
            torch.linalg.solve_triangular(factor, own_score[:, :, None], upper=False).square().sum((1, 2))
        )
        occam = torch.diagonal(factor, dim1=1, dim2=2).log().sum(1)
        started = score[alike.shift] - 0.5 * square
        value = 0.5 * explained - occam + started
        if bool(alike.is_one_sided.any()):  # what cannot be negative has twice the density on one side
            sd_above_0 = own_score[:, 0].sign() * explained.sqrt()
            value = value + torch.where(
                alike.is_one_sided, torch.special.log_ndtr(sd_above_0) + math.log(2.0), 0.0
            )
        return torch.where(failed == 0, value, -math.inf)

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


def _padded(n: int) -> int:
    """Number of columns with empty ones, so that many items are computed at once: a small number, or the next 4, 8, 16, 32 ... beyond.

    Examples:
        >>> [_padded(n) for n in (1, 2, 3, 4, 5, 9, 33)]
        [1, 2, 3, 4, 8, 16, 64]
    """
    return n if n < SMALL else 1 << (n - 1).bit_length()

"""Evidence of items beside others in the linear model, with all sizes integrated out: it depends on inner products alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.linear import Projector
from estimator.diagnosis.mixture.evidence_kernel import (
    RIDGE,
    fill_blocks,
    log_bayes_factors,
    subtract_from_blocks,
)
from estimator.diagnosis.mixture.items import Dictionary, Item, renumbered
from estimator.inference.positive_definite import inner_products, lower_factor

# Share of the columns of all chosen items up to which an exchange takes less time than all anew, and how often in turn: each adds rounding
MOST_EXCHANGED, MOST_EXCHANGES = 0.5, 30
UNDECIDED = 1e-4  # share of a direction from which on readings, or its prior, decide it alone


class Products:
    """Inner products, after projection, of all columns of a dictionary, an empty column, and last the residual.

    Directions of the rig's numbers that readings alone decide are projected out for good. Those that their priors hold as well are columns
    beside those of the items: what the numbers follow of them is less where the noise is larger.

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
        shares, turn = torch.linalg.eigh(inner_products(always.basis))
        followed = turn.T @ (always.basis.T @ vectors)
        self.gram = (inner_products(vectors) - inner_products(followed)).cpu().contiguous()
        is_held = (shares > UNDECIDED) & (shares < 1.0 - UNDECIDED)
        self.shares, self.followed = shares[is_held].cpu(), followed[is_held].cpu()
        self.n = n - int((shares >= 1.0 - UNDECIDED).sum())
        self._lay_out(dictionary.items)

    def among(self, numbers: Sequence[int]) -> Products:
        """Inner products for some of the items alone, which are numbered anew."""
        items, columns = renumbered(self.items, numbers)
        rows = torch.tensor([*columns, self.empty, self.residual])
        few = copy(self)
        few.gram, few.followed = self.gram[rows][:, rows].contiguous(), self.followed[:, rows]
        few._lay_out(items)
        return few

    def _lay_out(self, items: Sequence[Item]) -> None:
        """Note where the columns of each item are, as machine code reads it: the last one of each is its start."""
        self.items = tuple(items)
        self.empty, self.residual = len(self.gram) - 2, len(self.gram) - 1
        sizes = [len(item.columns) + 1 for item in items]
        self.begin = np.cumsum([0, *sizes])
        columns = [c for i, item in enumerate(items) for c in (*item.columns, self.start_of(i))]
        self.columns = np.array(columns, dtype=np.int64)
        self.widths = np.array([width for item in items for width in (*item.widths, 0.0)], dtype=float)
        self.is_one_sided = np.array([item.is_one_sided for item in items], dtype=bool)
        self.first, self.n_in_blocks = np.zeros(len(items), dtype=np.int64), 0
        for i, (item, last) in enumerate(zip(items, [None, *items], strict=False)):
            if last is not None and (last.columns, last.shift) == (item.columns, item.shift):
                self.first[i] = self.first[i - 1]
            else:
                self.first[i], self.n_in_blocks = self.n_in_blocks, self.n_in_blocks + sizes[i] ** 2

    def start_of(self, item: int) -> int:
        """Column by which the start of an item changes the predictions."""
        shift = self.items[item].shift
        return self.empty if shift is None else shift

    def of(self, chosen: Sequence[int]) -> tuple[Tensor, Tensor, Tensor]:
        """Numbers and widths of the columns of some items, and how the residual is made of columns once their starts are there."""
        columns = [column for i in chosen for column in self.items[i].columns]
        widths = [width for i in chosen for width in self.items[i].widths]
        mixture = self.gram.new_zeros(len(self.gram))
        mixture[self.residual] = 1.0
        for i in chosen:
            mixture[self.start_of(i)] -= 1.0
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

    def beside(self, chosen: Sequence[int], noise: float) -> Float[Tensor, " item"]:
        """Log Bayes factor of each item beside some others, against these alone."""
        return Beside(self, chosen, noise).evidence()

    def gains(self, chosen: Sequence[int], noise: float) -> dict[int, float]:
        """Log Bayes factor of each of some items beside the others, against these alone, by its number."""
        beside = Beside(self.among(chosen), range(len(chosen)), noise)
        return {number: float(beside.evidence(without=i)[i]) for i, number in enumerate(chosen)}

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
        missed, followed = self.followed @ mixture, self.followed[:, columns] * widths
        square = mixture @ self.gram @ mixture + missed.square().sum()
        # A direction of which readings decide a share s is one column of length s / (1 - s) over its prior.
        length = (1.0 - self.shares).rsqrt()
        of_items = self.gram[columns][:, columns] * widths[:, None] * widths + followed.T @ followed
        with_held = length[:, None] * followed
        own = torch.cat(
            (
                torch.cat((torch.diag(self.shares * length.square()), with_held), 1),
                torch.cat((with_held.T, of_items), 1),
            )
        )
        score = torch.cat((length * missed, widths * (self.gram[columns] @ mixture) + followed.T @ missed))
        size, vectors = torch.linalg.eigh(own)
        size, variance = size.clamp(min=0.0), noise.square()[:, None]
        explained = (vectors.T @ score).square() / variance / (variance + size)
        at_noise_of_fit = (
            0.5 * torch.log1p(-self.shares).sum()
        )  # no change there: `Asked.log_density_of` counts it
        result = -self.n * noise.log() - 0.5 * square / variance[:, 0] - at_noise_of_fit
        return result + 0.5 * (explained - torch.log1p(size / variance)).sum(1)


class Beside:
    """All items beside some that are there, or beside all but one of these.

    Without one of them, all that it alone followed of a column is free again: a product of as many rows as it has columns, instead of
    one more system of all columns. So are items exchanged for a few others.

    Args:
        products: Of all items.
        chosen: Numbers of those that are there.
        noise: Factor on the noise of the fit.
        signal: Combination of columns that stands for the residual, where something else than what was measured is asked about.
        before: All items beside others, at the same noise.
    """

    def __init__(
        self,
        products: Products,
        chosen: Sequence[int],
        noise: float,
        signal: Float[Tensor, " column"] | None = None,
        before: Beside | None = None,
    ) -> None:
        self.products, self.chosen, self.precision = products, tuple(chosen), 1.0 / noise**2
        columns, widths, self.mixture = products.of(chosen)
        if signal is not None:
            self.mixture = self.mixture + signal
            self.mixture[products.residual] = 0.0
        self.scaled = products.gram[columns] * (widths * self.precision)[:, None]
        self.factor = lower_factor(_with_unit_prior(self.scaled[:, columns] * widths))
        self.score = self._rest(self.mixture)
        self.n_exchanges, self.blocks = 0, np.empty(products.n_in_blocks)
        if before is not None and before.n_exchanges < MOST_EXCHANGES:
            gone, new = set(before.chosen).difference(chosen), set(chosen).difference(before.chosen)
            n_exchanged = sum(len(products.items[i].columns) for i in gone | new)
            if n_exchanged < MOST_EXCHANGED * len(columns):
                self.n_exchanges, self.blocks = before.n_exchanges + 1, before.blocks.copy()
                self._subtract(before._freed(gone), -1.0)
                self._subtract(self._freed(new), 1.0)
        if self.n_exchanges == 0:
            fill_blocks(products.gram.numpy(), self.precision, *self._layout, self.blocks)
            self._subtract(torch.linalg.solve_triangular(self.factor, self.scaled, upper=False), 1.0)

    @property
    def _layout(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.products.begin, self.products.columns, self.products.first

    def _subtract(self, rows: Float[Tensor, "row column"], sign: float) -> None:
        """Subtract from the inner products what is followed along some directions, or add it again."""
        if len(rows):
            subtract_from_blocks(rows.T.contiguous().numpy(), sign, *self._layout, self.blocks)

    def evidence(self, without: int | None = None) -> Float[Tensor, " item"]:
        """Log Bayes factor of each item beside the others, against these alone.

        Args:
            without: Number of one of the chosen items that is not there; all are by default.
        """
        products, score = self.products, self.score
        freed = self._freed(() if without is None else (without,))
        if without is not None:
            start = torch.zeros_like(score)
            start[products.start_of(without)] = 1.0
            score = score + self._rest(start) + (freed @ (self.mixture + start)) @ freed
        result = np.empty(len(products.items))
        log_bayes_factors(
            self.blocks,
            freed.T.contiguous().numpy(),
            score.numpy(),
            products.begin,
            products.columns,
            products.widths,
            products.first,
            products.is_one_sided,
            result,
        )
        return torch.from_numpy(result)

    def _rest(self, mixture: Float[Tensor, " column"]) -> Float[Tensor, " column"]:
        """Inner products of all columns with a combination of some, less what the chosen items follow."""
        of_it = mixture.nonzero()[:, 0]
        own = mixture[of_it]
        whole = own @ self.products.gram[of_it] * self.precision
        followed = torch.cholesky_solve((self.scaled[:, of_it] @ own)[:, None], self.factor)
        return whole - followed[:, 0] @ self.scaled

    def _freed(self, items: Collection[int]) -> Float[Tensor, "own column"]:
        """What some of the chosen items alone follow of each column, along orthonormal directions."""
        sizes = [len(self.products.items[i].columns) for i in self.chosen]
        is_own = np.repeat([i in items for i in self.chosen], sizes)
        own = torch.from_numpy(np.flatnonzero(is_own))
        unit = self.factor.new_zeros(len(self.factor), len(own))
        unit[own, torch.arange(len(own))] = 1.0
        inverse = torch.cholesky_solve(unit, self.factor)
        rows = inverse.T @ self.scaled
        return torch.linalg.solve_triangular(lower_factor(inverse[own]), rows, upper=False)


def _with_unit_prior(gram: Float[Tensor, "*batch column column"]) -> Float[Tensor, "*batch column column"]:
    """Precision of coefficients with standard normal priors."""
    diagonal = torch.diagonal(gram, dim1=-2, dim2=-1)
    return gram + torch.diag_embed(1.0 + RIDGE * diagonal.abs())

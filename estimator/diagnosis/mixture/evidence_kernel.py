"""Evidence of many items of a few columns each, in machine code: they are too many and too small for one call of a library each."""

from __future__ import annotations

from functools import partial
from math import erfc, inf, log, pi, sqrt

import numpy as np

from estimator.field.machine_code import machine_code

RIDGE = 1e-10  # of the square of a column: what rounding leaves of those that the rig's numbers follow
FAR = (
    -30.0
)  # standard deviations below which the normal distribution function is taken by its asymptotic form
MANY = 16  # columns of an item from which on a library multiplies them

compiled = partial(machine_code, is_in_order=False)


@compiled
def _log_twice_below(x):  # type: ignore[no-untyped-def]
    """Logarithm of twice the normal distribution function."""
    if x > FAR:
        return log(erfc(-x / sqrt(2.0)))
    return log(2.0) - 0.5 * x * x - log(-x) - 0.5 * log(2.0 * pi)


@compiled
def _subtract(block, rows, chosen, sign):  # type: ignore[no-untyped-def]
    """Subtract from inner products of some columns what rows of a matrix follow of them; only the lower triangle is read."""
    n = len(chosen)
    if n < MANY:
        for a in range(n):
            for b in range(a + 1):
                product = 0.0
                for r in range(rows.shape[1]):
                    product += rows[chosen[a], r] * rows[chosen[b], r]
                block[a, b] -= sign * product
        return
    own = rows[chosen]
    taken = np.dot(own, own.T)
    for a in range(n):
        for b in range(a + 1):
            block[a, b] -= sign * taken[a, b]


@compiled
def _log_bayes_factor(rest, own, widths, is_one_sided, factor, reached):  # type: ignore[no-untyped-def]
    """Log Bayes factor of one item by the Cholesky factor of the precision of its coefficients, which is made row after row."""
    value = 0.0
    for a in range(len(widths)):
        left = own[a] * widths[a]
        for b in range(a):
            entry = rest[a, b] * widths[a] * widths[b]
            for r in range(b):
                entry -= factor[a, r] * factor[b, r]
            factor[a, b] = entry / factor[b, b]
            left -= factor[a, b] * reached[b]
        diagonal = rest[a, a] * widths[a] * widths[a]
        pivot = diagonal + 1.0 + RIDGE * abs(diagonal)
        for r in range(a):
            pivot -= factor[a, r] * factor[a, r]
        if not pivot > 0.0:
            return -inf
        factor[a, a] = sqrt(pivot)
        reached[a] = left / factor[a, a]
        value += 0.5 * reached[a] * reached[a] - log(factor[a, a])
    if is_one_sided:  # what cannot be negative has twice the density on one side
        value += _log_twice_below(reached[0])
    return value


@compiled
def fill_blocks(gram, precision, begin, columns, first, blocks):  # type: ignore[no-untyped-def]
    """Inner products of the columns of each item.

    Args:
        gram: Inner products of all columns, in units of the fitted noise.
        precision: Inverse square of the factor on the noise.
        begin: First of the columns of each item, and last their number.
        columns: Numbers of the columns of all items, one after the other; of each, its start is the last.
        first: By item, where its block begins; items with the same columns share one.
        blocks: Square matrices, one after the other; their lower triangles are overwritten.
    """
    for i in range(len(first)):
        if i > 0 and first[i] == first[i - 1]:
            continue
        chosen = columns[begin[i] : begin[i + 1]]
        n = len(chosen)
        block = blocks[first[i] : first[i] + n * n].reshape(n, n)
        for a in range(n):
            for b in range(a + 1):
                block[a, b] = gram[chosen[a], chosen[b]] * precision


@compiled
def subtract_from_blocks(rows, sign, begin, columns, first, blocks):  # type: ignore[no-untyped-def]
    """Subtract from such inner products what others follow of the columns, or add it again.

    Args:
        rows: By column, what is followed of it along orthonormal directions.
        sign: 1 to subtract, -1 to add.
        begin, columns, first: As in `fill_blocks`.
        blocks: Their lower triangles are changed.
    """
    for i in range(len(first)):
        if i > 0 and first[i] == first[i - 1]:
            continue
        chosen = columns[begin[i] : begin[i + 1]]
        n = len(chosen)
        _subtract(blocks[first[i] : first[i] + n * n].reshape(n, n), rows, chosen, sign)


@compiled
def log_bayes_factors(blocks, freed, score, begin, columns, widths, first, is_one_sided, result):  # type: ignore[no-untyped-def]
    """Log Bayes factor of each item beside some others.

    Args:
        blocks: What `fill_blocks` has made.
        freed: By column, what is no longer followed of it, along orthonormal directions.
        score: By column, its inner product with what the others leave of the residual.
        begin, columns, first: As in `fill_blocks`.
        widths: Prior standard deviations of the columns; those of starts are not read.
        is_one_sided: By item, whether its only quantity cannot be negative.
        result: By item; overwritten.
    """
    most = 1
    for i in range(len(first)):
        most = max(most, begin[i + 1] - begin[i])
    rest, factor = np.empty((most, most)), np.empty((most, most))
    own, reached = np.empty(most), np.empty(most)
    started = 0.0
    for i in range(len(first)):
        chosen = columns[begin[i] : begin[i + 1]]
        last = len(chosen) - 1
        if i == 0 or first[i] != first[i - 1]:
            rest[: last + 1, : last + 1] = blocks[first[i] : first[i] + (last + 1) ** 2].reshape(
                last + 1, last + 1
            )
            _subtract(rest, freed, chosen, -1.0)
            for a in range(last):
                own[a] = score[chosen[a]] - rest[last, a]
            started = score[chosen[last]] - 0.5 * rest[last, last]
        own_widths = widths[begin[i] : begin[i + 1] - 1]
        result[i] = started + _log_bayes_factor(rest, own, own_widths, is_one_sided[i], factor, reached)


@compiled
def log_bayes_factors_of_choices(gram, score, prior_sd, begin, columns, factors, is_one_sided, result):  # type: ignore[no-untyped-def]
    """Log Bayes factor of some of the columns of each candidate alone, at some width.

    Args:
        gram: Inner products of the columns of each candidate.
        score: Of each column with the residual.
        prior_sd: Stated width of each column.
        begin: First of the columns of each choice, and last their number.
        columns: Of all choices, one after the other.
        factors: On the stated widths, by choice.
        is_one_sided: By candidate and choice, whether its only quantity cannot be negative.
        result: By candidate and choice; overwritten.
    """
    most = gram.shape[1]
    rest, factor = np.empty((most, most)), np.empty((most, most))
    own, widths, reached = np.empty(most), np.empty(most), np.empty(most)
    for i in range(len(gram)):
        for choice in range(len(factors)):
            chosen = columns[begin[choice] : begin[choice + 1]]
            for a in range(len(chosen)):
                for b in range(a + 1):
                    rest[a, b] = gram[i, chosen[a], chosen[b]]
                own[a] = score[i, chosen[a]]
                widths[a] = prior_sd[i, chosen[a]] * factors[choice]
            some = widths[: len(chosen)]
            one_sided = is_one_sided[i, choice]
            result[i, choice] = _log_bayes_factor(rest, own, some, one_sided, factor, reached)

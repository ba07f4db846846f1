"""Evidence of many items of a few columns each, in machine code: they are too many and too small for one call of a library each."""

from __future__ import annotations

from functools import partial
from math import erfc, inf, log, pi, sqrt

import numpy as np

from estimator.field.kernel import machine_code

RIDGE = 1e-10  # of the square of a column: what rounding leaves of those that the rig's numbers follow
FAR = (
    -30.0
)  # standard deviations below which the normal distribution function is taken by its asymptotic form

compiled = partial(machine_code, is_in_order=False)


@compiled
def _log_twice_below(x):  # type: ignore[no-untyped-def]
    """Logarithm of twice the normal distribution function."""
    if x > FAR:
        return log(erfc(-x / sqrt(2.0)))
    return log(2.0) - 0.5 * x * x - log(-x) - 0.5 * log(2.0 * pi)


@compiled
def log_bayes_factors(  # type: ignore[no-untyped-def]
    gram, followed, score, begin, columns, widths, shift, is_one_sided, is_like_before, precision, result
):
    """Log Bayes factor of each item beside some others.

    Args:
        gram: Inner products of all columns, in units of the fitted noise.
        followed: By column, what the others follow of it along orthonormal directions.
        score: By column, its inner product with what the others leave of the residual.
        begin: First of the columns of each item, and last their number.
        columns, widths: Of all items, one after the other: numbers of columns, and prior standard deviations.
        shift: By item the column by which its start changes the predictions.
        is_one_sided: By item, whether its only quantity cannot be negative.
        is_like_before: By item, whether it has the columns and the start of the one before.
        precision: Inverse square of the factor on the noise.
        result: By item; overwritten.
    """
    n_items, n_followed = len(shift), followed.shape[1]
    most = 1
    for i in range(n_items):
        most = max(most, begin[i + 1] - begin[i])
    rest, factor = np.empty((most, most)), np.empty((most, most))
    own, reached = np.empty(most), np.empty(most)
    started = 0.0
    for i in range(n_items):
        first, n, at = begin[i], begin[i + 1] - begin[i], shift[i]
        if not is_like_before[i]:
            for a in range(n):
                column = columns[first + a]
                for b in range(a + 1):
                    other = columns[first + b]
                    product = gram[column, other] * precision
                    for r in range(n_followed):
                        product -= followed[column, r] * followed[other, r]
                    rest[a, b] = product
                product = gram[column, at] * precision
                for r in range(n_followed):
                    product -= followed[column, r] * followed[at, r]
                own[a] = score[column] - product
            square = gram[at, at] * precision
            for r in range(n_followed):
                square -= followed[at, r] * followed[at, r]
            started = score[at] - 0.5 * square
        value = started
        for a in range(n):
            width = widths[first + a]
            left = own[a] * width
            for b in range(a):
                entry = rest[a, b] * width * widths[first + b]
                for r in range(b):
                    entry -= factor[a, r] * factor[b, r]
                factor[a, b] = entry / factor[b, b]
                left -= factor[a, b] * reached[b]
            diagonal = rest[a, a] * width * width
            pivot = diagonal + 1.0 + RIDGE * abs(diagonal)
            for r in range(a):
                pivot -= factor[a, r] * factor[a, r]
            if not pivot > 0.0:
                value = -inf
                break
            factor[a, a] = sqrt(pivot)
            reached[a] = left / factor[a, a]
            value += 0.5 * reached[a] * reached[a] - log(factor[a, a])
        if is_one_sided[i]:  # what cannot be negative has twice the density on one side
            value += _log_twice_below(reached[0])
        result[i] = value

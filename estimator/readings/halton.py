"""Halton's sequence: points that fill a cube evenly."""

from __future__ import annotations

import itertools

import numpy as np


def halton(n_axes: int, count: int) -> np.ndarray:
    """The first points of Halton's sequence in the unit cube, a row each. `scipy.stats.qmc` has it, too, and takes a second to load.

    Examples:
        >>> halton(2, 4).tolist()
        [[0.0, 0.0], [0.5, 0.3333333], [0.25, 0.6666667], [0.75, 0.1111111]]
    """
    points = np.zeros((count, n_axes))
    for axis, base in enumerate(_primes(n_axes)):
        left, place = np.arange(count), 1.0 / base
        while left.any():
            left, digit = np.divmod(left, base)
            points[:, axis] += digit * place
            place /= base
    return points


def _primes(count: int) -> list[int]:
    primes: list[int] = []
    for number in itertools.count(2):
        if len(primes) == count:
            break
        if all(number % prime for prime in primes):
            primes.append(number)
    return primes

"""Components that a converter or a log has spoilt: sentinels that stand for "no reading", and codes that wrapped around or lost a byte.

All is judged by codes, which count the steps of the last digit. A sentinel lies far outside all other codes and is a number that programs
use for it, or is repeated to the last digit. A code that wrapped differs from its neighbours by 256 or 65536 steps while nothing was set
anew; that shows only where fields change little from reading to reading.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Codes = npt.NDArray[np.float64]

FEWEST_CODES = 5  # other readings with which a sentinel is compared
FAR_OUT = 10.0  # times the largest other code: where a value that is repeated is no field
FAR_OUT_KNOWN = 3.0  # the same for numbers that are known sentinels
NINES = ("9999", "99999", "999999", "9999999")  # written by programs for a value that is missing
LEAST_BITS = 11  # of a lowest code: a field has the code -512 or -1024 by chance
WRAPS = (2.0**8, 2.0**16)  # codes: of one byte and of two
STEADY = 20.0  # times the usual change between readings, by which a wrap must exceed it
USUAL = 0.9  # quantile of changes that counts as usual


def sentinels(codes: Codes) -> list[int]:
    """Rows of a component whose code stands for "no reading".

    Examples:
        >>> sentinels(np.array([10.0, -20.0, 31.0, 9999.0, 17.0, 25.0, -2048.0, 8.0]))
        [3, 6]
        >>> sentinels(np.array([10.0, -20.0, 31.0, 40.0, 17.0, 25.0, 40.0, 8.0]))
        []
    """
    is_sentinel = np.zeros(len(codes), dtype=bool)
    while True:  # the largest is compared with all others, so that one sentinel does not hide another
        left = np.where(is_sentinel | np.isnan(codes), 0.0, np.abs(codes))
        if not left.any():
            break
        value = codes[int(left.argmax())]
        same = codes == value
        others = left[~same & (left > 0.0)]
        if len(others) < FEWEST_CODES:
            break
        beyond = abs(value) / float(others.max())
        known = _is_known(value)
        # A second sentinel may be nearly as large, so the bulk decides.
        bulk = abs(value) / float(np.quantile(others, USUAL))
        if not (bulk > FAR_OUT_KNOWN if known else same.sum() > 1 and beyond > FAR_OUT):
            break
        is_sentinel |= same
    return np.flatnonzero(is_sentinel).tolist()


def _is_known(code: float) -> bool:
    """Whether a code is all nines, or the lowest of a converter."""
    whole = round(abs(code))
    is_lowest = code < 0.0 and whole >= 2**LEAST_BITS and whole & (whole - 1) == 0
    return is_lowest or f"{whole:d}".rstrip("0") in NINES


def wrapped(codes: Codes, is_set_anew: npt.NDArray[np.bool_]) -> list[int]:
    """Rows of a component between a change by 256 or 65536 codes and the change back.

    Args:
        codes: In order of time.
        is_set_anew: Whether currents or places change much from each row to the next.

    Examples:
        >>> codes = np.round(100.0 * np.sin(0.2 * np.arange(40.0)) + 300.0)
        >>> codes[12:15] -= 65536.0
        >>> wrapped(codes, np.zeros(39, dtype=bool))
        [12, 13, 14]
    """
    measured = np.flatnonzero(~np.isnan(codes))
    if len(measured) < 2 * FEWEST_CODES:
        return []
    changes = np.diff(codes[measured])
    rows: set[int] = set()
    for wrap in WRAPS:
        small = np.abs(changes)[np.abs(changes) < 0.5 * wrap]
        usual = float(np.quantile(small, USUAL)) if len(small) > 0.5 * len(changes) else np.inf
        if STEADY * max(usual, 1.0) > wrap:
            continue
        jumps = np.flatnonzero(np.abs(np.abs(changes) - wrap) <= 4.0 * max(usual, 1.0)).tolist()
        jumps = [jump for jump in jumps if not is_set_anew[measured[jump] : measured[jump + 1]].any()]
        there = None
        for jump in jumps:
            if there is not None and changes[there] * changes[jump] < 0.0:
                rows.update(measured[there + 1 : jump + 1].tolist())
                there = None
            else:
                there = jump
    return sorted(rows) if len(rows) < 0.5 * len(measured) else []

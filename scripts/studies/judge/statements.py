"""What the judge says of one printed statement, and numbers as people read them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

MICRO = ("u", "µ", "μ")
FACTORS = {"": 1.0, "m": 1e-3, "n": 1e-9, **dict.fromkeys(MICRO, 1e-6)}
UNITS = "T|rad|A|m|s"
SIZE = re.compile(
    rf"(?P<number>[-−+]?\d[\d.,]*(?:e[-+]?\d+)?)\s*(?:(?P<prefix>[munµμ]?)(?P<unit>{UNITS})\b|(?P<percent>%))?"
)
SURE = 0.99  # a probability beyond which something is stated as a fact
HALF = 0.5  # of what is left of a probability that is told to be beyond 99 %, or below 1 %
CONDITION, PROBABILITY = "condition", "probability"
LAST_DIGIT = 0.5 + 1e-6  # of the last printed digit: what rounding explains
# Share of an error: it is a difference of fields a hundred times as large, which quadrature has to a millionth
SUMMED = 3e-4


@dataclass(frozen=True)
class Statement:
    """One statement, judged.

    Attributes:
        kind: What is stated, such as `good` or `unseen_error`.
        source: Which output has it: `calibrate` or `diagnose`.
        text: As it was printed.
        is_true: Whether it is so.
        why: The truth, beside which it can be checked.
        off: By how much a printed number is off, as a share of the true one; None where it is no number.
        stated: Probability with which it is stated; None where it is stated as a fact.
        aside: Why it is counted apart and is never false alone: `condition` where the text makes it depend on what is not so,
            `probability` where it is less sure than `SURE`; None else.
    """

    kind: str
    source: str
    text: str
    is_true: bool
    why: str
    off: float | None = None
    stated: float | None = None
    aside: str | None = None

    def to_json(self) -> dict[str, Any]:
        """In the form of JSON, without what does not apply."""
        return {key: value for key, value in asdict(self).items() if value is not None}


def size_of(text: str) -> float:
    """A printed size in SI units; per cent as a share.

    Examples:
        >>> size_of("24.9 uT"), size_of("1.7 mT"), size_of("−3.2"), size_of("88.5 %")
        (2.49e-05, 0.0017, -3.2, 0.885)
    """
    match = SIZE.search(text)
    if match is None:
        raise ValueError(f"text must hold a number; received {text!r}")
    number = float(match["number"].replace(",", "").replace("−", "-"))
    factor = 0.01 if match["percent"] else FACTORS[match["prefix"] or ""]
    return float(f"{number * factor:.12g}")


def probability_of(text: str) -> float:
    """A printed probability, or odds.

    Examples:
        >>> probability_of("94 %"), probability_of("> 99 %"), probability_of("< 1 %"), probability_of("odds 4 to 1")
        (0.94, 0.995, 0.005, 0.8)
        >>> probability_of("odds 1 to 4"), probability_of("even odds"), probability_of("odds beyond a billion to 1") > 0.999
        (0.2, 0.5, True)
    """
    if odds := re.search(r"odds (\S+|beyond a billion) to (\S+|beyond a billion)$", text):
        given, against = (1e9 if "billion" in part else size_of(part) for part in odds.groups())
        return given / (given + against)
    if "odds" in text:
        return 0.5
    p = size_of(text)
    return 1.0 - HALF * (1.0 - p) if text.startswith(">") else HALF * p if text.startswith("<") else p


def with_probability(statement: Statement, stated: float) -> Statement:
    """A statement with its probability, counted apart where that is not nearly one."""
    return replace(statement, stated=stated, aside=None if stated > SURE else PROBABILITY)


def agrees(printed: float, value: float, digits: int) -> bool:
    """Whether a number would be printed so, to this many digits.

    Examples:
        >>> agrees(24.9, 24.94, 3), agrees(24.9, 24.96, 3), agrees(25.0, 24.96, 3)
        (True, False, True)
    """
    if not (math.isfinite(printed) and math.isfinite(value)):
        return False
    largest = max(abs(printed), abs(value))
    if largest == 0.0:
        return True
    step = 10.0 ** (math.floor(math.log10(largest)) - digits + 1)
    return abs(printed - value) <= LAST_DIGIT * step + SUMMED * largest


def number_statement(
    kind: str, source: str, text: str, printed: float, values: Iterable[float], digits: int
) -> Statement:
    """Whether a printed number is one of those that the files give, to its digits; `off` is of the nearest.

    Args:
        printed: In the unit of `values`.
        values: Of the models that are handed out.
        digits: To which it was printed.
    """
    nearest = min(values, key=lambda value: abs(value - printed))
    off = abs(printed - nearest) / abs(nearest) if nearest else math.inf if printed else 0.0
    why = f"printed {printed:.6g}, from the files {nearest:.6g}"
    return Statement(kind, source, text, agrees(printed, nearest, digits), why, off)

"""Options that name numbers, such as coil1=3 or arm1=0,0,0.1,0,0,0."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from estimator.errors import InvalidInput, cut, quoted
from estimator.units import LARGEST

if TYPE_CHECKING:
    from estimator.tensors import Tensor


def named_numbers(text: str, option: str, count: int) -> tuple[str, list[float]]:
    """Parse an option such as coil1=3 or arm1=0,0,0.1,0,0,0: a name and finite numbers.

    Raises:
        InvalidInput: The text has another form or another count of numbers, or a number is too large.
    """
    name, _, values = text.partition("=")
    try:
        numbers = [float(value) for value in values.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise InvalidInput(
            f"{option} must look like NAME={','.join(['1.0'] * count)}; received {quoted(text)}"
        )
    if max(map(abs, numbers)) > LARGEST:
        raise InvalidInput(
            f"{option} must give numbers between {-LARGEST:g} and {LARGEST:g}; received {quoted(text)}"
        )
    return name, numbers


def named_number(texts: Sequence[str], option: str) -> dict[str, float]:
    """Parse options such as coil1=3 into numbers by name.

    Raises:
        InvalidInput: A text has another form, or a name comes twice.
    """
    numbers: dict[str, float] = {}
    for text in texts:
        name, (value,) = named_numbers(text, option, 1)
        if name in numbers:
            raise InvalidInput(f"{option} must name {cut(name)} once; received it again in {quoted(text)}")
        numbers[name] = value
    return numbers


def named_motions(texts: Sequence[str]) -> dict[str, Tensor]:
    """Parse options --motion such as arm1=0,0,0.1,0,0,0 into the six numbers of movers by name; errors as `named_numbers`."""
    from estimator.tensors import torch

    motions = (named_numbers(text, "--motion", 6) for text in texts)
    return {name: torch.tensor(values, dtype=torch.float64) for name, values in motions}

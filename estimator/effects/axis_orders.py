"""Three columns of numbers in another order or direction, as several mistakes of the record have them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, permutations, product
from operator import mul

from jaxtyping import Float

from estimator.effects.base import Starts, Theta, switch, vector
from estimator.tensors import Tensor, torch

READS = ("x_reads", "y_reads", "z_reads")
AS_CALLED, REVERSED = (dict(zip(READS, (s, 2.0 * s, 3.0 * s), strict=True)) for s in (1.0, -1.0))
_SIGNED = (
    dict(zip(READS, map(mul, order, signs), strict=True))
    for order in permutations((1.0, 2.0, 3.0))
    for signs in product((1.0, -1.0), repeat=3)
)
ORDERS: Starts = tuple(sorted(_SIGNED, key=lambda start: sum(start[key] != AS_CALLED[key] for key in READS)))
"""All signed permutations, the right one first, then those that change the fewest columns."""

QUANTITIES = tuple(switch(key, -3.0, 3.0, i + 1.0) for i, key in enumerate(READS))
"""Which component, 1 to 3, each column holds, negative where it is reversed."""


def reads_one_twice(values: Mapping[str, float]) -> tuple[str, str] | None:
    """The rule that values break which are no permutation."""
    if sorted(abs(values[key]) for key in READS) == [1.0, 2.0, 3.0]:
        return None
    return READS[0], "must be, with the other two, 1, 2 and 3 in some order and with any signs"


def is_in_order(order: Mapping[str, float]) -> bool:
    """Whether only signs are wrong, if anything is."""
    return all(abs(order[key]) == AS_CALLED[key] for key in READS)


def is_left_handed(order: Mapping[str, float]) -> bool:
    """Whether an order is no rotation of the axes."""
    numbers = [order[key] for key in READS]
    swaps = sum(abs(first) > abs(second) for first, second in combinations(numbers, 2))
    return (swaps + sum(number < 0.0 for number in numbers)) % 2 == 1


def meaning(values: Mapping[str, float]) -> str:
    """What each column holds.

    Examples:
        >>> meaning({"x_reads": 2.0, "y_reads": -1.0, "z_reads": 3.0})
        'x, y and z hold y, −x and z'
    """
    x, y, z = ("−" * (values[key] < 0.0) + "xyz"[abs(round(values[key])) - 1] for key in READS)
    return f"x, y and z hold {x}, {y} and {z}"


def recorded_from_true(theta: Theta) -> Float[Tensor, "*batch 1 3 3"]:
    """Matrix that puts true components into the columns of the record, with an axis of length 1 for readings or poses."""
    reads = vector(theta, READS)
    order = torch.nn.functional.one_hot(reads.abs().round().long() - 1, 3).to(reads.dtype)
    return order * torch.sign(reads)[..., None]

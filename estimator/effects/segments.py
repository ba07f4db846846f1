"""What was set up anew before each file, day or plane of a session: every segment has a place, a zero or a gain of its own.

Each segment has its quantities, all with the prior of what can be wrong once, so that no segment is the right one and the rig's own numbers
are the mean that further segments scatter about. A reading outside any segment, and a prediction, have none. What all segments share is
told by causes of one session (`base_misplaced`, `sensor_offset`, `axis_gain`), which do with fewer numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from jaxtyping import Float, Int

from estimator.effects.base import Quantities, Theta
from estimator.effects.circumstances import Extent
from estimator.tensors import Tensor, torch

FEWEST_SEGMENTS = 2  # one alone is the whole session
MOST_SEGMENTS = 12  # 72 numbers for places; what scatters from file to file beyond is not asked
KEY = re.compile(r"segment(?P<number>\d+)_(?P<rest>\w+)")


def extent_of_segments(keys: Iterable[str]) -> Extent:
    """An extent with the segments that keys of quantities tell of; where they tell of none, the default.

    Examples:
        >>> extent_of_segments(("segment7_x_T", "segment3_x_T", "gap_m")).segments
        (3, 7)
    """
    numbers = segments_of(keys)
    return Extent(segments=numbers) if numbers else Extent()


def split_key(key: str) -> tuple[int, str] | None:
    """Number of the segment and what it has there; None for other keys.

    Examples:
        >>> split_key("segment7_x_T")
        (7, 'x_T')
    """
    match = KEY.fullmatch(key)
    return (int(match["number"]), match["rest"]) if match else None


def segments_of(keys: Iterable[str]) -> tuple[int, ...]:
    """Numbers of the segments that keys of quantities tell of."""
    return tuple(sorted({part[0] for part in map(split_key, keys) if part}))


def in_each_segment(extent: Extent, quantities: Quantities) -> Quantities:
    """Copies of the quantities for every segment."""
    return tuple(replace(each, key=f"segment{n}_{each.key}") for n in extent.segments for each in quantities)


def each_segment(quantities: Quantities) -> dict[str, Any]:
    """What a cause declares that has these quantities in every segment."""
    return {
        "quantities": lambda extent: in_each_segment(extent, quantities),
        "extent_of": extent_of_segments,
        "depends_on": "which segment of a session",
    }


def of_segment(
    theta: Theta, suffixes: Sequence[str], segment: Int[Tensor, " row"]
) -> Float[Tensor, "*batch row suffix"]:
    """Quantities of each row's segment; zero where it has none."""
    numbers = segments_of(theta)
    if not numbers:
        return next(iter(theta.values())).new_zeros(len(segment), len(suffixes))
    rows = [torch.stack([theta[f"segment{n}_{suffix}"] for suffix in suffixes], dim=-1) for n in numbers]
    is_in = (segment[:, None] == torch.tensor(numbers, device=segment.device)).to(rows[0].dtype)
    return is_in @ torch.stack(rows, dim=-2)


def is_several(segments: tuple[int, ...]) -> bool:
    """Whether there are several segments, and not more than can be asked."""
    return FEWEST_SEGMENTS <= len(segments) <= MOST_SEGMENTS

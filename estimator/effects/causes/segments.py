"""What was set up anew before each file, day or plane of a session: every segment has a place, a zero or a gain of its own.

Each segment has its quantities, all with the prior of what can be wrong once, so that no segment is the right one and the rig's own numbers
are the mean that further segments scatter about. A reading outside any segment, and a prediction, have none. What all segments share is
told by causes of one session (`base_misplaced`, `sensor_offset`, `axis_gain`), which do with fewer numbers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import ClassVar

from jaxtyping import Float, Int

from estimator.effects.base import Quantity, Theta, normal
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import MotionEffect, ReadingEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.tensors import Tensor, torch

FEWEST_SEGMENTS = 2  # one alone is the whole session
MOST_SEGMENTS = 12  # 72 numbers for places; what scatters from file to file beyond is not asked
WHICH = "which segment of a session"  # what quantities of one depend on
KEY = re.compile(r"segment(?P<number>\d+)_(?P<rest>\w+)")


def _extent_of_keys(keys: Iterable[str]) -> Extent:
    """An extent with the segments that keys of quantities tell of; where they tell of none, the default.

    Examples:
        >>> _extent_of_keys(("segment7_x_T", "segment3_x_T", "gap_m")).segments
        (3, 7)
    """
    numbers = _numbers(keys)
    return Extent(segments=numbers) if numbers else Extent()


def split_key(key: str) -> tuple[int, str] | None:
    """Number of the segment and what it has there; None for other keys.

    Examples:
        >>> split_key("segment7_x_T")
        (7, 'x_T')
    """
    match = KEY.fullmatch(key)
    return (int(match["number"]), match["rest"]) if match else None


def _numbers(keys: Iterable[str]) -> tuple[int, ...]:
    return tuple(sorted({part[0] for part in map(split_key, keys) if part}))


def _each(extent: Extent, suffixes: Sequence[str], unit: str, sd: float) -> tuple[Quantity, ...]:
    """Quantities of these names for every segment, all with one unit and one width of their priors."""
    return tuple(normal(f"segment{n}_{suffix}", unit, sd) for n in extent.segments for suffix in suffixes)


def _of_segment(
    theta: Theta, suffixes: Sequence[str], segment: Int[Tensor, " row"]
) -> Float[Tensor, "*batch row suffix"]:
    """Quantities of each row's segment; zero where it has none."""
    numbers = _numbers(theta)
    if not numbers:
        return next(iter(theta.values())).new_zeros(len(segment), len(suffixes))
    rows = [torch.stack([theta[f"segment{n}_{suffix}"] for suffix in suffixes], dim=-1) for n in numbers]
    is_in = (segment[:, None] == torch.tensor(numbers, device=segment.device)).to(rows[0].dtype)
    return is_in @ torch.stack(rows, dim=-2)


def _is_several(segments: tuple[int, ...]) -> bool:
    return FEWEST_SEGMENTS <= len(segments) <= MOST_SEGMENTS


class SegmentReading(ReadingEffect):
    """A sensor says something else in each segment."""

    def extent_of(self, keys: Iterable[str]) -> Extent:
        """One with the segments that they tell of."""
        return _extent_of_keys(keys)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor was read in several segments, and not in more than can be asked."""
        return _is_several(circumstances.segments_of(place))

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """Quantities of segments in which the sensor was not read."""
        read = circumstances.segments_of(place)
        keys = [quantity.key for quantity in self.quantities(circumstances.extent)]
        return frozenset(key for key in keys if not set(_numbers([key])) <= set(read))

    def beyond_the_moment(self, key: str) -> str | None:
        """A moment lies in no segment."""
        return WHICH


class SegmentZero(SegmentReading):
    """The sensor was zeroed anew before each segment."""

    name: ClassVar[str] = "segment_zero"
    words: ClassVar[str] = "in each segment of the session the sensor shows another constant in no field"
    source: ClassVar[str] = (
        "zeroing in a chamber or in the field of the room leaves as much as sensor_offset says"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Components in the sensor frame, segment by segment."""
        return _each(extent, ("x_T", "y_T", "z_T"), "T", 50e-6)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T + _of_segment(theta, ("x_T", "y_T", "z_T"), circumstances.segment)


class SegmentGain(SegmentReading):
    """The sensor has another gain in each segment: another range, excitation or day."""

    name: ClassVar[str] = "segment_gain"
    words: ClassVar[str] = "in each segment of the session the sensor has another gain"
    source: ClassVar[str] = "ranges and excitation currents of Hall teslameters agree to 0.1 to 1 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of the gain of all axes, segment by segment."""
        return _each(extent, ("gain",), "1", 0.01)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T * (1.0 + _of_segment(theta, ("gain",), circumstances.segment))


class SegmentMisplaced(MotionEffect):
    """The mover was set up anew before each segment, and stands elsewhere each time, or turned."""

    name: ClassVar[str] = "segment_misplaced"
    words: ClassVar[str] = "in each segment of the session the mover stands elsewhere, or turned"
    source: ClassVar[str] = "feet, stops and references are found again to about 1 mm and 0.5 degree"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift and rotation vector in the frame that the mover reports in, segment by segment."""
        shift_and_turn = (
            (("x_m", "y_m", "z_m"), "m", 1e-3),
            (("rx_rad", "ry_rad", "rz_rad"), "rad", math.radians(0.5)),
        )
        return tuple(
            quantity
            for n in extent.segments
            for suffixes, unit, sd in shift_and_turn
            for quantity in _each(Extent(segments=(n,)), suffixes, unit, sd)
        )

    def extent_of(self, keys: Iterable[str]) -> Extent:
        """One with the segments that they tell of."""
        return _extent_of_keys(keys)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether there are several segments, and not more than can be asked."""
        return _is_several(circumstances.extent.segments)

    def beyond_the_moment(self, key: str) -> str | None:
        """A moment lies in no segment."""
        return WHICH

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Number of the segment."""
        return circumstances.segment.to(circumstances.current_A.dtype)[:, None]

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        segment = columns[:, 0].long()
        turn = rotation_from_vector(_of_segment(theta, ("rx_rad", "ry_rad", "rz_rad"), segment))
        return Transform(turn, _of_segment(theta, ("x_m", "y_m", "z_m"), segment)) @ pose

"""All causes by name, and which of them the studies choose from."""

from __future__ import annotations

from collections.abc import Iterable

from tests.hidden.causes import (
    bending,
    build,
    electronics,
    everyday,
    misstated,
    outside,
    over_time,
    record,
    robot,
    sensor,
    slips,
    supply,
    surroundings,
    unforeseen,
    visitors,
    winding,
    wiring,
)
from tests.hidden.flaw import Cause


def _by_name(modules: Iterable[tuple[Cause, ...]]) -> dict[str, Cause]:
    return {cause.name: cause for causes in modules for cause in causes}


# The first study is about these for good, whatever coilcal learns: its seeds keep their meaning.
FIRST = _by_name(module.CAUSES for module in (supply, winding, surroundings, robot, sensor, record, outside))
OUTSIDE = tuple(cause.name for cause in outside.CAUSES)
CAUSES = FIRST | _by_name(
    module.CAUSES
    for module in (over_time, misstated, build, bending, wiring, visitors, electronics, unforeseen)
)  # new ones at the end: seeds count them
UNFORESEEN = tuple(cause.name for cause in unforeseen.CAUSES)
EVERYDAY = tuple(cause.name for cause in everyday.CAUSES)
# Hidden only where it is asked for by name: no study that draws among many has these, so the seeds of all keep their meaning.
LATER = _by_name((slips.CAUSES, everyday.CAUSES))
ALL = CAUSES | LATER


def names(protocol: str, *, is_known: bool = True, is_pattern: bool = True) -> tuple[str, ...]:
    """Causes of the first study that can happen in a protocol.

    Args:
        protocol: `paper` or `recommended`.
        is_known: Those that coilcal knew then, or those outside.
        is_pattern: Only those of a continuous size whose effect is a pattern (not noise): what a visible size is defined for.
    """
    return tuple(
        cause.name
        for cause in FIRST.values()
        if (cause.name not in OUTSIDE) == is_known
        and protocol in cause.protocols
        and (not is_pattern or cause.has_size)
    )


def patterns(protocol: str, motion: str) -> tuple[str, ...]:
    """All causes with a visible size that can happen in a session; those that are only hidden by name stand last."""
    return tuple(
        cause.name
        for cause in ALL.values()
        if cause.has_size and protocol in cause.protocols and motion in cause.motions
    )

"""All causes by name: those that a diagnosis may know, and those that it must not be able to name."""

from __future__ import annotations

from tests.hidden.causes import outside, record, robot, sensor, supply, surroundings, winding
from tests.hidden.flaw import Cause

CAUSES: dict[str, Cause] = {
    cause.name: cause
    for module in (supply, winding, surroundings, robot, sensor, record, outside)
    for cause in module.CAUSES
}


def names(protocol: str, *, is_known: bool = True, is_pattern: bool = True) -> tuple[str, ...]:
    """Causes that can happen in a protocol.

    Args:
        protocol: `paper` or `recommended`.
        is_known: Those of the library, or those outside.
        is_pattern: Only those of a continuous size whose effect is a pattern (not noise): what a visible size is defined for.
    """
    return tuple(
        cause.name
        for cause in CAUSES.values()
        if cause.is_known == is_known and protocol in cause.protocols and (not is_pattern or cause.has_size)
    )

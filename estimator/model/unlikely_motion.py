"""Positions of movers that no laboratory has, most likely by a wrong unit. They may be true, so they are told and not refused."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.units import UNITS, split_unit

FARTHEST_M = 10.0  # that a mover of a laboratory stands from its reference: a thousandth is a stage's travel
# Travel of all movers together, where one moves at all: a thousand times as much is an arm's reach
LEAST_TRAVEL_M = 5e-4
MOST_UNITS = 2  # that are told of numbers a factor too large


def unlikely_motion(rig: Rig, observations: Observations, where: str) -> list[str]:
    """Sentences on positions beyond any laboratory, and on travels too small for what moves, with the lines and the cure.

    Args:
        rig: Its movers; joint angles are no lengths.
        observations: Their positions.
        where: File or session that messages name.
    """
    return [*_too_far(rig, observations, where), *_too_little(rig, observations, where)]


def _too_far(rig: Rig, observations: Observations, where: str) -> Iterator[str]:
    for mover in (mover for mover in rig.movers if mover.table is None):
        position_m = observations.motion[mover.name][:, :3]
        is_far = (position_m.abs() > FARTHEST_M).any(dim=1)
        if not bool(is_far.any()):
            continue
        row = int(is_far.nonzero()[0])
        axis = int(position_m[row].abs().argmax())
        first = f"reading {row + 1}" if observations.line is None else f"line {int(observations.line[row])}"
        more = f" and {int(is_far.sum()) - 1} more" if int(is_far.sum()) > 1 else ""
        column = mover.columns[axis]
        yield (
            f"{column} is {float(position_m[row, axis]):.4g} m in {first}{more}: movers of laboratories stay within {FARTHEST_M:g} m; "
            f"they look like {look_like(column, 1e3)} ({where})."
        )


def _too_little(rig: Rig, observations: Observations, where: str) -> Iterator[str]:
    travels_m = {
        mover: float(
            ((motion := observations.motion[mover.name][:, :3]).amax(dim=0) - motion.amin(dim=0)).max()
        )
        for mover in rig.movers
        if mover.table is None
    }
    farthest = max(travels_m, key=travels_m.__getitem__, default=None)
    is_all = len(travels_m) == len(rig.movers)  # an arm that reports angles may move everything
    if farthest is not None and is_all and 0.0 < travels_m[farthest] < LEAST_TRAVEL_M:
        yield (
            f"{farthest.name} moves by {1e3 * travels_m[farthest]:.3g} mm at most: hardly any field changes so near; "
            f"positions may be in m; {_cure(split_unit(farthest.columns[0])[0], ['m'])} ({where})."
        )


def look_like(column: str, factor: float, besides: str = "") -> str:
    """Units that numbers may truly have which are too large, whatever their file calls them, and what to do: `mm called m, or ...`.

    Args:
        column: Name of a column of such numbers, with a unit of theirs.
        factor: By which they are too large.
        besides: What else it may be.
    """
    quantity, stated = split_unit(column)
    alike = [unit for unit in UNITS.values() if stated is not None and unit.dimension == stated.dimension]
    pairs = [
        (true.symbol, called.symbol)
        for called in alike
        for true in alike
        if math.isclose(called.to_si / true.to_si, factor, rel_tol=1e-6)
    ][:MOST_UNITS]
    units = ", or ".join(f"{true} called {called}" for true, called in pairs)
    return f"{units}{besides}; {_cure(quantity, [true for true, _ in pairs])}"


def _cure(quantity: str, units: Sequence[str]) -> str:
    names = " or ".join(f"'HEADER={quantity}_{unit}'" for unit in units)
    return f"if so, name them so in the file, or with --column {names} when they are imported"


def scaled(rig: Rig, observations: Observations, kind: str, factor: float) -> Observations:
    """Readings with all positions, or with all rotations and joint angles, times a factor."""
    motion = {}
    for mover in rig.movers:
        numbers = observations.motion[mover.name].clone()
        is_joint = mover.table is not None
        columns = slice(0, 6) if is_joint else slice(3, 6) if kind == "rotations" else slice(0, 3)
        if not (is_joint and kind == "positions"):
            numbers[:, columns] *= factor
        motion[mover.name] = numbers
    return replace(observations, motion=motion)

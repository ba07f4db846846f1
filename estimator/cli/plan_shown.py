"""What `coilcal acquire --dry-run` shows of a measurement."""

from __future__ import annotations

import itertools
from typing import Any

from estimator.cli.acquire_task import Task
from estimator.cli.words import duration_words, motion_words

MOST_SHOWN = 10


def plan_record(task: Task) -> dict[str, Any]:
    """The planned stops, for programs."""
    rig, stops = task.bench.rig, task.stops
    if task.pilot is not None:
        return {"candidates": len(stops), **task.pilot.header, "first": task.pilot.decide([]).to_json()}
    begins_s = list(itertools.accumulate(task.times_s, initial=0.0))
    return {
        "plan": task.plan.name,
        "readings_per_stop": task.pace.n_readings,
        "duration_s": sum(task.times_s),
        "stops": [
            {
                "begin_s": begins_s[row],
                "current_A": {coil.name: float(stops.current_A[row, i]) for i, coil in enumerate(rig.coils)},
                **{mover.name: stops.motion[mover.name][row].tolist() for mover in rig.movers},
                "is_validation": bool(stops.is_validation[row]),
            }
            for row in range(len(stops))
        ],
    }


def plan_text(task: Task) -> str:
    """The first planned stops and the duration, for people."""
    record = plan_record(task)
    if task.pilot is not None:
        return "\n".join(
            [
                f"{record['candidates']} stops to choose from, at most {task.n_stops} visits",
                *(f"goal: {goal}" for goal in record["goals"]),
            ]
        )
    n_validation = int(task.stops.is_validation.sum())
    lines = [
        f"plan {record['plan']!r}: {len(task.stops)} stops ({n_validation} for validation), {record['readings_per_stop']} readings each, "
        f"about {duration_words(record['duration_s'])}"
    ]
    for number, stop in enumerate(record["stops"][:MOST_SHOWN], start=1):
        currents = ", ".join(f"{name} {current_A:g} A" for name, current_A in stop["current_A"].items())
        motions = "; ".join(
            f"{mover.name} {motion_words(mover, stop[mover.name])}" for mover in task.bench.rig.movers
        )
        lines.append(f"  {number:4} after {duration_words(stop['begin_s']):>10}: {currents}; {motions}")
    if len(task.stops) > MOST_SHOWN:
        lines.append(f"  ... and {len(task.stops) - MOST_SHOWN} more (--json lists all)")
    return "\n".join(lines)

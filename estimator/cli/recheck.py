"""`coilcal recalibrate --measure`: the shortest session that decides whether the current calibration still holds."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from estimator.acquisition.pace import Pace
from estimator.cli.acquire_task import check_plan, measured, read_task
from estimator.cli.contents import ending
from estimator.cli.instruments import Bench
from estimator.cli.output import EXIT_DRIFTED, EXIT_NOT_CONVERGED, show
from estimator.errors import InvalidInput
from estimator.planning.choosing import Pilot
from estimator.planning.decision import Limits
from estimator.readings.observations import Observations
from estimator.recalibration.recheck import CHANGED, HOLDS, Recheck
from estimator.recalibration.registry import Registry
from estimator.recalibration.sequential import FALSE_ALARMS, MISSES, Rates
from estimator.rig.rig import Rig
from estimator.store.journal import read_journal
from estimator.store.session import SESSION, is_growing, seal
from estimator.store.staging import check_output

N_READINGS, LONGEST_SETTLE_S = 10, 10.0  # at each stop, as of `coilcal acquire`
EXIT_CODES = {HOLDS: 0, CHANGED: EXIT_DRIFTED}


def recheck(
    bench: Bench,
    registry: Path,
    out: Path,
    plan_path: Path | None,
    percent: float,
    most_stops: int,
    seed: int,
    as_json: bool,
) -> None:
    """Measure until the current version of a registry holds or has changed; ends the program with the exit code.

    Args:
        bench: Rig and instruments.
        registry: Whose current version is asked.
        out: Session to write, or to go on with.
        plan_path: Places and currents to choose from.
        percent: Of the field, that a change is.
        most_stops: After which to end in any case.
        seed: Of the candidates where there are many.
        as_json: Print JSON.
    """
    versions = Registry(registry)
    if versions.current is None:
        raise InvalidInput(f"registry must have a calibration to measure against; {registry} has none")
    is_resumed = is_growing(out)
    if not is_resumed:
        check_output(out, False, SESSION)
    calibration, ends = versions.calibration(), Limits(most_stops)

    def still_holds(_: Rig, candidates: Observations, pace: Pace, __: int) -> Pilot:
        return Recheck(calibration, candidates, 0.01 * percent, pace, ends, Rates())

    task = read_task(bench, plan_path, N_READINGS, LONGEST_SETTLE_S, None, seed, still_holds)
    header, records = read_journal(out) if is_resumed else ({}, [])
    loads = check_plan(task, records, time.time() - header["begin_s"] if records else 0.0)
    measured(task, out, is_resumed, loads, lambda: None)
    session, end = seal(out), ending(out)
    rates = f"{FALSE_ALARMS:.0%} false alarms, {MISSES:.0%} misses of changes by {percent:g} % of the field"
    lines = [f"{end['reason']} ({rates}); version {versions.current} is current", *_details(end)]
    n_stops = len(session.observations) // len(bench.rig.sensors)
    result = {"session": str(out), "stops": n_stops, "current": versions.current, "ended": end}
    show(result, "\n".join(lines), as_json)
    sys.exit(EXIT_CODES.get(end["outcome"], EXIT_NOT_CONVERGED))


def _details(end: Mapping[str, Any]) -> list[str]:
    """What has changed, and what these stops do not show."""
    left_out = end["left_out"]
    lines = [f"  as of {words}" for words in end["leading"]] if end["outcome"] != HOLDS else []
    return (
        [*lines, f"not tested, for these stops do not show it: {', '.join(left_out)}"] if left_out else lines
    )

"""`coilcal plan`: which stops to measure, before any reading."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.options import PATH, OutputPath, devices_option, option, result_options, seed_option
from estimator.cli.output import CoilcalCommand, show
from estimator.errors import listed

if TYPE_CHECKING:
    from estimator.planning.planned import Planned

MOST_STOPS = 2000
CURVE = (0.1, 0.25, 0.5, 0.75, 1.0)  # shares of the stops at which the expected intervals are printed
MOST_UNKNOWN = 8  # parameters that are printed


@click.command("plan", cls=CoilcalCommand)
@click.argument("rig_path", metavar="RIG", type=PATH)
@click.argument("plan_path", metavar="[PLAN]", required=False, type=PATH)
@option(
    "--goal goals",
    "What shall be known: 'field 0.2 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25' (or 'in ball r_mm=30', 'in points FILE'; 'worst' after "
    "the unit for every point instead of the mean), 'parameters coil1.radius_m 0.05 mm', or 'causes axis_gain[hall].x=0.01'. Repeatable.",
    multiple=True,
    metavar="GOAL",
)
@option(
    "--stops n_stops", "Number of stops; by default as many as the goals need.", click.IntRange(2, MOST_STOPS)
)
@option(
    "--order",
    "Order of the stops: the shortest way, or random, which tells drift from place.",
    click.Choice(["tour", "random"]),
    default="tour",
)
@option(
    "--settle settle_s",
    "Seconds from arrival to the first reading; by default those of PLAN.",
    click.FloatRange(min=0.0, min_open=True),
)
@devices_option
@option("--out", "Plan to write (YAML), for coilcal acquire and coilcal simulate.", OutputPath())
@seed_option
@result_options
def plan_command(
    rig_path: Path,
    plan_path: Path | None,
    settle_s: float | None,
    devices_path: Path | None,
    out: Path | None,
    overwrite: bool,
    as_json: bool,
    **wanted: Any,
) -> None:
    """Plan a measurement of RIG before any reading.

    Stops are chosen from the poses and currents of PLAN, within the limits of the instruments; without PLAN, from displacements that fill
    the workspace of each arm. The model is linearised at 64 draws of the priors. Some stops are held out, some are without current, some
    are visited again; each says in a comment why it is there. Without a goal, all free parameters together count.
    """
    from dataclasses import replace

    from drivers.limits_section import RigLimits, limits_of
    from estimator.acquisition.pace import default_pace
    from estimator.cli.instruments import Bench
    from estimator.cli.places import places_of
    from estimator.cli.plan_limits import check_currents, check_ways
    from estimator.cli.progress import COUNTED_EVERY_S, UNTOLD_S, Reporter
    from estimator.planning.plan import plan
    from estimator.rig_files.read import load_rig
    from estimator.store.staging import check_output, write_output

    if out is not None:
        check_output(out, overwrite)
    rig, limits = load_rig(rig_path), RigLimits()
    if rig.devices or devices_path is not None:
        bench = Bench.load(rig_path, devices_path)
        with bench.located():
            limits = limits_of(bench.devices)
    places = places_of(rig, plan_path, limits)
    pace = default_pace(rig, settle_s or places.settle_s)
    speeds = {name: arm.highest_speed_m_per_s for name, arm in limits.arms.items()}
    pace = replace(pace, speed_m_per_s={**pace.speed_m_per_s, **speeds}, slew_A_per_s=limits.slews_A_per_s)
    with Reporter(COUNTED_EVERY_S, UNTOLD_S, UNTOLD_S) as reporter:
        planned = plan(rig, places, pace=pace, on_count=reporter.count, **wanted)
    if limits.currents:
        check_currents(planned.stops, rig, limits, planned.times_s)
    if limits.arms:
        check_ways(planned.stops, rig, limits, pace, {})
    if out is not None:
        write_output(out, planned.text, overwrite)
    show({**planned.to_json(), "plan": None if out is None else str(out)}, _text(planned, out), as_json)


def _text(planned: Planned, out: Path | None) -> str:
    from estimator.cli.words import duration_words
    from estimator.reporting.numbers import displays

    n = len(planned.stops)
    lines = [
        f"{n} stops ({int(planned.stops.is_validation.sum())} held out), about {duration_words(planned.duration_s)}; in random order "
        f"{duration_words(planned.random_duration_s)}"
    ]
    counts = sorted({max(1, round(share * n)) for share in CURVE})
    for goal, widths in zip(planned.goals, planned.expected, strict=True):
        lines.append(f"goal: {goal}")
        curve = ", ".join(f"{widths[count - 1]:.2g} after {count}" for count in counts)
        lines.append(f"  expected half-width over the wanted one: {curve}")
    if planned.goals:
        needed = planned.n_needed
        lines.append(
            f"all goals are expected to be reached after {needed} stops"
            if needed
            else "not all goals are reached; give more --stops"
        )
    if planned.not_told:
        names = listed(planned.not_told, len(planned.not_told))
        lines.append(
            f"these currents do not tell {names} from the coils, and half-widths hold only where they are not there: the Earth's field is "
            "25 to 65 µT; add places without current, or currents of both signs"
        )
    if planned.unknown:
        shown = displays(list(planned.unknown))
        most_first = sorted(planned.unknown.items(), key=lambda item: -item[1])[:MOST_UNKNOWN]
        words = [f"{shown[name].words} ({100.0 * share:.0f} %)" for name, share in most_first]
        lines.append(
            f"stays unknown, with its share of the prior's width: {listed(words, len(planned.unknown))}"
        )
    lines.append(f"plan: {out}" if out else "give --out to write them as a plan")
    return "\n".join(lines)

"""What coilcal understood of a rig file, a readings CSV or a plan: as lines for people and as a record for programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from estimator.cli.words import duration_words, prior_words
from estimator.readings.plan import Plan
from estimator.reporting.numbers import SHOWN_IN
from estimator.rig.bodies import Body, Coil, EquivalentSourceCoil, Mover, SidedCoil
from estimator.rig.parameters import Parameter
from estimator.rig.rig import Rig
from estimator.units import UNITS

if TYPE_CHECKING:
    from estimator.store.importers.table import Table

MOST_FREE = 30  # parameters that are listed one by one; a coil without a winding has hundreds


def rig_record(rig: Rig) -> dict[str, Any]:
    """A rig as JSON: names of things, and the free parameters with their priors in SI."""
    return {
        "name": rig.name,
        "coils": [coil.name for coil in rig.coils],
        "sensors": [sensor.name for sensor in rig.sensors],
        "movers": {mover.name: str(mover.motion) for mover in rig.movers},
        "causes": [cause.label for cause in rig.acting],
        "devices": list(rig.devices),
        "free": {p.name: {"unit": p.unit, "prior": prior_words(p.prior)} for p in rig.free if p.prior},
        "fixed": len(rig.parameters) - len(rig.free),
    }


def rig_lines(rig: Rig) -> list[str]:
    """A rig in a few lines."""
    values = rig.nominal_values()
    lines = [f"rig {rig.name!r}"]
    lines += [f"  coil {coil.name}: {_coil_words(coil, values)}; {_place_words(coil)}" for coil in rig.coils]
    lines += [
        f"  sensor {sensor.name}: noise {_shown(values[f'{sensor.name}.noise_T'], 'T')}; {_place_words(sensor)}"
        for sensor in rig.sensors
    ]
    lines += [f"  mover {mover.name}: {_mover_words(mover)}" for mover in rig.movers]
    if rig.acting:
        lines.append(f"  with {', '.join(cause.label for cause in rig.acting)}")
    if rig.devices:
        lines.append(f"  instruments of {', '.join(rig.devices)}")
    lines.append(f"  free parameters: {len(rig.free) or 'none'}; a fit moves these and keeps all others")
    width = max((len(parameter.name) for parameter in rig.free), default=0)
    lines += [f"    {p.name:{width}}  {_prior_shown(p)}" for p in rig.free[:MOST_FREE]]
    if len(rig.free) > MOST_FREE:
        lines.append(f"    and {len(rig.free) - MOST_FREE} more")
    return lines


def readings_record(table: Table) -> dict[str, Any]:
    """A readings CSV as JSON: number of rows, and of each column its unit and its range in that unit."""
    return {"readings": len(table.lines), "columns": _columns(table)}


def readings_lines(table: Table) -> list[str]:
    """A readings CSV in a few lines."""
    width = max(map(len, table.header))
    lines = [f"{len(table.lines)} readings"]
    for quantity, told in _columns(table).items():
        if "words" in told:
            words = ", ".join(f"{word or 'empty'} ({number})" for word, number in told["words"].items())
        elif told["low"] is None:
            words = "empty"
        else:
            words = f"{told['low']:.6g} to {told['high']:.6g} {told['unit']}"
            words += f", {told['empty']} empty" if told["empty"] else ""
        lines.append(f"  {quantity:{width}}  {words.rstrip()}")
    return lines


def plan_record(plan: Plan, rig: Rig) -> dict[str, Any]:
    """A plan as JSON."""
    n_poses = len(plan.calibration) + 2 * plan.n_revisited + len(plan.validation)
    n_stops = (n_poses * len(plan.currents_A) + len(plan.stops)) * plan.repeats
    return {
        "name": plan.name,
        "poses": len(plan.calibration) + len(plan.stops),
        "poses_for_validation": len(plan.validation),
        "settings_of_current": len(plan.currents_A),
        "stops": n_stops,
        "readings": n_stops * len(rig.sensors),
        "settling_s": n_stops * plan.settle_s,
        "order": plan.order,
    }


def plan_lines(plan: Plan, rig: Rig) -> list[str]:
    """A plan in a few lines."""
    told = plan_record(plan, rig)
    poses = f"{told['poses']} poses, {told['poses_for_validation']} more for validation only"
    return [
        f"plan {plan.name!r}",
        f"  {poses}; settings of the currents: {told['settings_of_current']}; order {plan.order}",
        f"  {told['stops']} stops, {told['readings']} readings; {duration_words(told['settling_s'])} of settling",
    ]


def _coil_words(coil: Body, values: Mapping[str, float]) -> str:
    name = coil.name
    if not isinstance(coil, Coil | SidedCoil):
        if isinstance(coil, EquivalentSourceCoil):
            n = len(coil.multipoles_m)
            beside = f" and {n} multipole{'s' if n > 1 else ''} beside it" if n else ""
            return f"no winding, {coil.n_charges} magnetic charges on a box{beside}"
        return "no winding, a sum of solid harmonics"
    loops = " x ".join(f"{values[f'{name}.{count}']:g}" for count in ("axial_loops", "radial_loops"))
    if isinstance(coil, SidedCoil):
        sides = " x ".join(_shown(values[f"{name}.inner_side_{axis}_m"], "m") for axis in "xy")
        corners = "sharp corners"
        if coil.is_rounded:
            corners = f"corners of radius {_shown(values[f'{name}.inner_corner_radius_m'], 'm')}"
        return f"winding about a bore of {sides} with {corners}, {loops} loops"
    return f"winding of radius {_shown(values[f'{name}.radius_m'], 'm')}, {loops} loops"


def _place_words(body: Body) -> str:
    return "stands still" if body.carried_by is None else f"carried by {body.carried_by}"


def _mover_words(mover: Mover) -> str:
    columns, turning = list(mover.columns), ""
    if mover.table is None:
        columns, rotation = columns[:3], columns[3:]
        turning = f", and {', '.join(rotation)} where it turns"
    return f"{mover.motion}; columns {', '.join(columns)}{turning}"


def _shown(value: float, unit: str) -> str:
    symbol = SHOWN_IN.get(unit, unit)
    return f"{value / UNITS[symbol].to_si:.6g} {symbol}"


def _prior_shown(parameter: Parameter) -> str:
    """Prior of a free parameter in the unit of its display."""
    assert parameter.prior is not None
    unit = UNITS.get(SHOWN_IN.get(parameter.unit, ""))
    if unit is None:
        return prior_words(parameter.prior, unit=parameter.unit.removeprefix("1"))
    return prior_words(parameter.prior, 1.0 / unit.to_si, unit.symbol)


def _columns(table: Table) -> dict[str, dict[str, Any]]:
    """Unit and range of each column of numbers, in that unit; how often each word stands in a column of words."""
    from estimator.store.importers.forms.preview import si_symbol  # with what reads tables

    columns: dict[str, dict[str, Any]] = {}
    for quantity, cell in table.header.items():
        if table.columns[quantity].numbers is None:
            columns[quantity] = {"words": table.word_counts(quantity)}
            continue
        named, to_si = cell.text.removeprefix(f"{quantity}_"), cell.to_si
        unit = named if named in UNITS else si_symbol(quantity)
        values = table.numbers(quantity, may_be_empty=True) / (to_si if named in UNITS else 1.0)
        given = values[~values.isnan()]
        ends = (None, None) if not len(given) else (float(given.min()), float(given.max()))
        columns[quantity] = {"unit": unit, "low": ends[0], "high": ends[1], "empty": len(values) - len(given)}
    return columns

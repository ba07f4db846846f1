"""Values of a rig's numbers that are impossible, whatever is measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

from estimator.rig.bodies import Coil, SidedCoil, WoundCoil
from estimator.rig.parameters import Parameter

MOST_LOOPS = 5000  # along or across one winding; the exact sum, beside which a quadrature rule is chosen, grows with their square
MOST_TURNS = 200_000  # of one winding
ROUNDING = 1e-12  # of lengths that are the same but for their units


def broken_rules(
    parameters: Mapping[str, Parameter], wound: Iterable[WoundCoil], values: Mapping[str, float]
) -> Iterator[tuple[str, str, str]]:
    """Every impossible value: parameter, broken rule and value.

    Args:
        parameters: Of the rig, by name.
        wound: Its coils whose winding is described.
        values: Value of every parameter.
    """
    for name, value in values.items():
        parameter = parameters[name]
        if not math.isfinite(value):
            yield name, "must be finite", f"{value}"
        elif parameter.is_count and value < 1.0:
            yield name, "must be at least 1", f"{value:g}"
        elif parameter.is_count and value > MOST_LOOPS:
            yield name, f"must be at most {MOST_LOOPS}", f"{value:g}"
        # A noise of 0 is fine in a simulation, a length of 0 is not.
        elif parameter.is_positive and (value < 0.0 or (value == 0.0 and parameter.unit == "m")):
            yield name, "must be > 0", f"{value:g} {parameter.unit}"
    for coil in wound:
        if isinstance(coil, SidedCoil):
            yield from _broken_corners(coil, values)
        else:
            yield from _broken_bore(coil, values)
        turns = values[f"{coil.name}.axial_loops"] * values[f"{coil.name}.radial_loops"]
        if turns > MOST_TURNS:
            rule = f"x radial_loops must be at most {MOST_TURNS}"
            yield f"{coil.name}.axial_loops", rule, f"{turns:g}"


def _broken_bore(coil: Coil, values: Mapping[str, float]) -> Iterator[tuple[str, str, str]]:
    radius_m = values[f"{coil.name}.radius_m"]
    thickness_m = values[f"{coil.name}.radial_pitch_m"] * values[f"{coil.name}.radial_loops"]
    if radius_m <= thickness_m:
        rule = f"must exceed radial_pitch x radial_loops = {thickness_m * 1e3:.6g} mm (no bore is left)"
        yield f"{coil.name}.radius_m", rule, f"{radius_m * 1e3:.6g} mm"


def _broken_corners(coil: SidedCoil, values: Mapping[str, float]) -> Iterator[tuple[str, str, str]]:
    if not coil.is_rounded:
        return
    radius_m = values[f"{coil.name}.inner_corner_radius_m"]
    shorter_m = min(values[f"{coil.name}.inner_side_{axis}_m"] for axis in "xy")
    if radius_m > 0.5 * shorter_m * (1.0 + ROUNDING):
        rule = f"must be at most half the shorter side, {500.0 * shorter_m:.6g} mm"
        yield f"{coil.name}.inner_corner_radius_m", rule, f"{radius_m * 1e3:.6g} mm"

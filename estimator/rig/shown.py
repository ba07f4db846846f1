"""What a terminal and a notebook show of a rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from estimator.errors import listed
from estimator.glance import Glance, sections_svg, with_unit
from estimator.rig.parameters import Uniform
from estimator.rig.rig import Rig


def glance(rig: Rig) -> Glance:
    """A rig in a sentence, its free numbers, and its windings in section.

    Examples:
        >>> print(glance(Rig.coil(0.05, 30, 12, wire_radius_m=0.0004, name="bench")).text())
        Rig 'bench': coil coil1; sensor hall; mover stage (displacement); effects background_field[room], sensor_offset[hall].
        20 numbers are free, 22 fixed.
          free number          prior
          coil1.radius_m       50 ± 2.5 mm
          coil1.wire_radius_m  0.4 ± 0.02 mm
          coil1.axial_loops    30 ± 1.5
          coil1.radial_loops   12 ± 0.6
          hall.noise_T         20 ± 10 µT
          hall.gain            1 ± 0.01
          and 14 more
    """
    bodies = [_listed("coil", [coil.name for coil in rig.coils])]
    bodies.append(_listed("sensor", [sensor.name for sensor in rig.sensors]))
    if rig.movers:
        bodies.append(_listed("mover", [f"{mover.name} ({mover.motion})" for mover in rig.movers]))
    if rig.acting:
        bodies.append(_listed("effect", [cause.label for cause in rig.acting]))
    n_fixed = len(rig.parameters) - len(rig.free)
    sentence = f"Rig {rig.name!r}: {'; '.join(bodies)}. {len(rig.free)} numbers are free, {n_fixed} fixed."
    rows = []
    for parameter in rig.free:
        prior: Any = parameter.prior
        if isinstance(prior, Uniform):
            shown = f"{with_unit(prior.lower, parameter.unit)} to {with_unit(prior.upper, parameter.unit)}"
        else:
            shown = with_unit(prior.centre, parameter.unit, prior.sd)
        rows.append((parameter.name, shown))
    sections = _sections(rig)
    label = "windings in section (mm), each on its own axis"
    return Glance(
        sentence,
        ("free number", "prior"),
        rows,
        (lambda: sections_svg(sections, label)) if sections else None,
    )


def _listed(kind: str, names: Sequence[str]) -> str:
    return f"{kind if len(names) == 1 else f'{kind}s'} {listed(names[:4], len(names))}"


def _sections(rig: Rig) -> list[tuple[str, float, float, float, float]]:
    """Round windings side by side, in mm."""
    values, sections, begin = rig.nominal_values(), [], 0.0
    for coil in rig.round:
        outer, length, thickness = (
            1e3 * values[f"{coil.name}.radius_m"],
            1e3 * values[f"{coil.name}.axial_pitch_m"] * values[f"{coil.name}.axial_loops"],
            1e3 * values[f"{coil.name}.radial_pitch_m"] * values[f"{coil.name}.radial_loops"],
        )
        sections.append((coil.name, outer - thickness, outer, begin, begin + length))
        begin += 1.5 * length
    return sections

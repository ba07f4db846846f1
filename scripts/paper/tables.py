"""Shared by the studies of the paper: its simulated coil under coilcal's names, and the layout of tables.

Osinde, Etievant, Byiringiro and Andreff, "Calibration of a multi-mobile coil magnetic manipulation system utilizing a control-oriented
magnetic model". Every printed number stands in `printed.py`.
"""

from __future__ import annotations

from collections.abc import Sequence

from scripts.paper import printed

NAMES = tuple(f"coil1.{key}" for key in ("radius_m", "wire_radius_m", "axial_loops", "radial_loops"))
CURRENT_A, DISTANCE_M = 3.0, 0.04  # our choice: the paper states neither current nor grid


def coil(winding: printed.Winding) -> dict[str, float]:
    """A printed winding under the names of coilcal, in SI.

    Examples:
        >>> coil(printed.SIMULATED_TRUTH)["coil1.radius_m"]
        0.051
    """
    radius_mm, wire_mm, axial, radial = winding
    return dict(zip(NAMES, (radius_mm / 1e3, wire_mm / 1e3, float(axial), float(radial)), strict=True))


START, TRUTH, FOUND = (
    coil(winding) for winding in (printed.SIMULATED_START, printed.SIMULATED_TRUTH, printed.SIMULATED_FOUND)
)


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns below a title, in Markdown."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        for row in (header, *rows)
    ]
    rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
    return "\n".join((f"**{title}**", "", lines[0], rule, *lines[1:], ""))

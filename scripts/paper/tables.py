"""Shared by the studies of the paper: its numbers that are at hand, and the layout of tables.

Osinde, Etievant, Byiringiro and Andreff, "Calibration of a multi-mobile coil magnetic manipulation system utilizing a control-oriented
magnetic model". Only notes of it were at hand: truth and start of its simulated coil, the turns and length that its Table 3 recovered, and
the design of its studies. Every other number of its tables is printed as a dash; none is made up.
"""

from __future__ import annotations

from collections.abc import Sequence

NOT_AT_HAND = "-"
NAMES = tuple(f"coil1.{key}" for key in ("radius_m", "wire_radius_m", "axial_loops", "radial_loops"))
START = dict(zip(NAMES, (0.048, 0.46e-3, 45.0, 22.0), strict=True))
TRUTH = dict(zip(NAMES, (0.051, 0.49e-3, 48.0, 25.0), strict=True))
FOUND_TURNS, FOUND_LENGTH_M = 1196.0, 0.04702  # Table 3; the truth is 1200 turns on 47.04 mm
CURRENT_A, DISTANCE_M = (
    3.0,
    0.04,
)  # our choice: the paper states neither the current nor the position of its grid


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns below a title, in Markdown."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        for row in (header, *rows)
    ]
    rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
    return "\n".join((f"**{title}**", "", lines[0], rule, *lines[1:], ""))

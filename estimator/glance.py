"""What a terminal and a notebook show of a result: a sentence, a small table and a figure."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from typing import Any, ClassVar

MOST_LINES = 10  # of a representation
MOST_OF_SENTENCE = 3
LONGEST = 118  # characters of a line

# Units for people, by those of parameters.
SHOWN_IN = {"m": (1e3, "mm"), "rad": (57.29577951308232, "°"), "T": (1e6, "µT"), "1": (1.0, "")}


@dataclass(frozen=True)
class Glance:
    """What is shown of an object.

    Attributes:
        sentence: What it is.
        header: Of the table.
        rows: Of the table; the last are left out where they are many.
        picture: The figure as HTML, drawn when a notebook asks for it; None without one.
    """

    sentence: str
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    picture: Callable[[], str] | None = field(default=None, repr=False)

    def shown_rows(self, room: int = MOST_LINES - 2) -> list[list[str]]:
        """Header and as many rows as there is room for; the last says how many more there are."""
        rows = [list(row) for row in self.rows]
        if len(rows) > room:
            left_out = len(rows) - room + 1
            rows = [*rows[: room - 1], [f"and {left_out} more", *[""] * (len(self.header) - 1)]]
        return [list(self.header), *rows] if rows else []

    def text(self) -> str:
        """The sentence and the table, at most ten lines.

        Examples:
            >>> print(Glance("Two coils.", ["coil", "radius"], [["a", "1 mm"], ["long", "20 mm"]]).text())
            Two coils.
              coil  radius
              a     1 mm
              long  20 mm
        """
        sentence = textwrap.wrap(" ".join(self.sentence.split()), LONGEST)[:MOST_OF_SENTENCE]
        lines = [f"  {line}" for line in aligned(self.shown_rows(MOST_LINES - 1 - len(sentence)))]
        cut = [line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..." for line in lines]
        return "\n".join([*sentence, *cut])

    def html(self) -> str:
        """The sentence, the table and the figure as HTML, everything escaped."""
        rows = self.shown_rows()
        cells = [
            "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"
            for tag, row in zip(["th", *["td"] * len(rows)], rows, strict=False)
        ]
        table = f"<table>{''.join(cells)}</table>" if cells else ""
        figure = self.picture() if self.picture is not None else ""
        return f"<div><p>{escape(self.sentence)}</p>{table}{figure}</div>"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """A table as lines with aligned columns.

    Examples:
        >>> aligned([["coil", "radius"], ["a", "1 mm"]])
        ['coil  radius', 'a     1 mm']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


class Shown:
    """An object whose representation is a glance at it. Its dataclass must be declared with `repr=False`.

    Tables and pictures of it are made by the module `shown` of its package, which stands above it and is loaded when they are asked for.
    """

    _package: ClassVar[str]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if Shown in cls.__bases__:
            cls._package = cls.__module__.rpartition(".")[0]

    @property
    def _shown(self) -> Any:
        """The module `shown`."""
        return import_module(f"{self._package}.shown")

    def glance(self) -> Glance:
        """What is shown of it: a sentence, a table and a figure."""
        return self._shown.glance(self)

    def __repr__(self) -> str:
        return self.glance().text()

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return self.glance().html()


def with_unit(value: float, unit: str, sd: float | None = None) -> str:
    """A number in the unit for people, with its standard deviation where there is one.

    Examples:
        >>> with_unit(0.051, "m"), with_unit(0.051, "m", 0.0004), with_unit(13.0, "1")
        ('51 mm', '51 ± 0.4 mm', '13')
    """
    factor, symbol = SHOWN_IN.get(unit, (1.0, unit))
    spread = "" if sd is None else f" ± {sd * factor:.2g}"
    return f"{value * factor:.5g}{spread} {symbol}".strip()


def scatter_svg(
    x: Sequence[float], y: Sequence[float], is_marked: Sequence[bool], x_label: str, y_label: str
) -> str:
    """Points as a small picture; marked ones are hollow.

    Args:
        x, y: Places, at least one.
        is_marked: Which are hollow.
        x_label, y_label: What the axes are, with units.
    """
    width, height, margin = 420.0, 180.0, 34.0

    def placed(values: Sequence[float], start: float, end: float) -> list[float]:
        low, high = min(values), max(values)
        span = (high - low) or 1.0
        return [start + (value - low) / span * (end - start) for value in values]

    across, up = placed(x, margin, width - 8.0), placed(y, height - margin, 8.0)
    points = "".join(
        f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.2" fill="{"none" if marked else "#0072b2"}" stroke="#0072b2"/>'
        for a, b, marked in zip(across, up, is_marked, strict=True)
    )
    left, bottom = margin - 6.0, height - margin + 6.0
    ends = (f"{min(x):.4g}", f"{max(x):.4g}", f"{min(y):.4g}", f"{max(y):.4g}")
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}" role="img" '
        f'aria-label="{escape(f"{y_label} against {x_label}")}" font-family="sans-serif" font-size="10" fill="currentColor">'
        f'<path d="M{left:g} 4V{bottom:g}H{width - 4:g}" fill="none" stroke="currentColor"/>{points}'
        f'<text x="{left:g}" y="{bottom + 12:g}">{ends[0]}</text>'
        f'<text x="{width - 4:g}" y="{bottom + 12:g}" text-anchor="end">{ends[1]}</text>'
        f'<text x="{width / 2:g}" y="{bottom + 22:g}" text-anchor="middle">{escape(x_label)}</text>'
        f'<text x="{left + 4:g}" y="{bottom - 2:g}">{ends[2]}</text>'
        f'<text x="{left + 4:g}" y="14">{ends[3]} {escape(y_label)}</text></svg>'
    )


def sections_svg(sections: Sequence[tuple[str, float, float, float, float]], label: str) -> str:
    """Windings in section as a small picture, each from its own side: rectangles above and below their axis.

    Args:
        sections: Name, inner and outer radius, and where it begins and ends along the axis, in mm.
        label: What the picture shows.
    """
    top = max(outer for _, _, outer, _, _ in sections)
    low, high = min(start for *_, start, _ in sections), max(end for *_, end in sections)
    scale = min(150.0 / (2.0 * top), 360.0 / ((high - low) or 1.0))
    middle = 90.0
    parts = []
    for name, inner, outer, start, end in sections:
        x, width = 30.0 + (start - low) * scale, max(1.0, (end - start) * scale)
        for y in (middle - outer * scale, middle + inner * scale):
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{max(1.0, (outer - inner) * scale):.1f}" fill="#d55e00"/>'
            )
        parts.append(f'<text x="{x:.1f}" y="{middle - 4:g}">{escape(name)}</text>')
    return (
        f'<svg viewBox="0 0 420 190" width="420" height="190" role="img" aria-label="{escape(label)}" '
        'font-family="sans-serif" font-size="10" fill="currentColor">'
        f'<path d="M10 {middle:g}H410" stroke="currentColor" stroke-dasharray="8 3 2 3"/>{"".join(parts)}'
        f'<text x="10" y="184">{escape(label)}</text></svg>'
    )

"""One self-contained page from sentences, tables and pictures; it knows nothing of calibrations.

Pictures are embedded as PNG at twice the screen's resolution, styles are inline: the file can be mailed, printed and kept.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from estimator.errors import InvalidInput

PIXELS_PER_INCH = 96
OVERSAMPLING = 2
NUMBER = re.compile(r"[<>≈+−-]?\s*[\d.]|—?$")


@dataclass(frozen=True)
class Table:
    """Cells as they are printed, units included; `caption` is a sentence on what to look at.

    Raises:
        InvalidInput: A row has more or fewer cells than the header.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.header):
                raise InvalidInput(
                    f"rows of table {self.title!r} must have {len(self.header)} cells; received {list(row)}"
                )

    @property
    def is_number(self) -> list[bool]:
        """Which columns hold nothing but numbers (with units, or — for none); they are aligned to the right.

        Examples:
            >>> Table("", ["name", "median"], [["radius", "50.98 mm"], ["loops", "—"]]).is_number
            [False, True]
        """
        return [all(NUMBER.match(row[i]) for row in self.rows) for i in range(len(self.header))]


@dataclass(frozen=True)
class Picture:
    """A figure and one sentence that says what to look for."""

    title: str
    caption: str
    figure: Figure

    @property
    def width_px(self) -> int:
        """Width on the screen."""
        return round(self.figure.get_figwidth() * PIXELS_PER_INCH)

    @property
    def png_base64(self) -> str:
        """The figure's pixels."""
        buffer = io.BytesIO()
        dpi = OVERSAMPLING * PIXELS_PER_INCH
        self.figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
        return base64.b64encode(buffer.getvalue()).decode("ascii")


@dataclass(frozen=True)
class ReportPage:
    """What a report says, in the order in which it says it.

    Attributes:
        title: Rig.
        subtitle: Date, source of the readings.
        verdict: Sentences with the numbers that matter; the first is printed large.
        warnings: Sentences on what the reader must not overlook; no box where there are none.
        tables: Below the verdict.
        figures: Below the tables.
        appendix: Tables below the figures, for those who want to know more.
        provenance: Command, versions, hashes, seed.
    """

    title: str
    subtitle: str
    verdict: Sequence[str]
    warnings: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Picture] = ()
    appendix: Sequence[Table] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)


def render_report(page: ReportPage) -> str:
    """The page as HTML that needs no other file; all text is escaped.

    Examples:
        >>> page = ReportPage("rig <a>", "2026-01-01", ["The coil is calibrated."])
        >>> "<h1>rig &lt;a&gt;</h1>" in render_report(page)
        True
    """
    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return templates.get_template("report.html.j2").render(page=page)

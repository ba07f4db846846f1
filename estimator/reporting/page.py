"""A self-contained HTML page of sentences, tables and pictures, for any report.

Pictures are embedded as PNG at twice the screen's resolution and styles are inline, so that the file can be mailed, printed and archived.
As SVG they would take as long, since most of the time goes into their layout, and most of them two to three times the bytes.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from estimator.errors import InvalidInput
from estimator.reporting.forks import in_forks

PIXELS_PER_INCH = 96
OVERSAMPLING = 2
COLOURS = 256  # of a picture; colour maps have 256 at most, and lines few
NUMBER = re.compile(r"[<>≈+−-]?\s*[\d.]|—?$")


@dataclass(frozen=True)
class Table:
    """A table with its cells as printed, units included; `caption` says what to look at.

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
        """Columns that hold only numbers (with units, or — for a missing one); they are aligned to the right.

        Examples:
            >>> Table("", ["name", "median"], [["radius", "50.98 mm"], ["loops", "—"]]).is_number
            [False, True]
        """
        return [all(NUMBER.match(row[i]) for row in self.rows) for i in range(len(self.header))]


@dataclass(frozen=True)
class Picture:
    """A figure with a sentence that says what to look for.

    Attributes:
        title: What it shows.
        caption: What to look for.
        plot: The figure, or what draws it, which a page does for several side by side.
    """

    title: str
    caption: str
    plot: Figure | Axes | Callable[[], Figure | Axes]

    @cached_property
    def figure(self) -> Figure:
        """The figure, drawn when it is first asked for."""
        plot = self.plot() if callable(self.plot) else self.plot
        figure = plot.figure if isinstance(plot, Axes) else plot
        assert isinstance(figure, Figure)  # Axes of a sub-figure are in no page
        return figure

    @property
    def width_px(self) -> int:
        """Width on the screen, in pixels."""
        return round(self.figure.get_figwidth() * PIXELS_PER_INCH)

    @property
    def png_base64(self) -> str:
        """The figure as a PNG file with a palette, base64-encoded: a quarter of the size, and no eye sees the difference."""
        file = io.BytesIO()
        image = Image.fromarray(_pixels(self.figure)).convert("RGB")
        palette = image.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        palette.save(file, format="png")
        return base64.b64encode(file.getvalue()).decode("ascii")


def _pixels(figure: Figure) -> UInt8[np.ndarray, "row column 4"]:
    """A figure as red, green, blue and opacity. `savefig` would draw it twice, the first time only to lay it out."""
    dpi, before = figure.dpi, figure.canvas
    figure.set_dpi(OVERSAMPLING * PIXELS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    figure.set_canvas(before)
    figure.set_dpi(dpi)
    return np.asarray(canvas.buffer_rgba())


def picture_html(title: str, plot: Figure | Callable[[], Figure | Axes]) -> str:
    """A figure as an image of HTML, for a notebook.

    Args:
        title: Read out where the image is not seen.
        plot: The figure, or what draws it.
    """
    picture = Picture(title, "", plot)
    return f'<img alt="{escape(title)}" width="{picture.width_px}" src="data:image/png;base64,{picture.png_base64}"/>'


@dataclass(frozen=True)
class Drawn:
    """A picture as a page shows it."""

    title: str
    caption: str
    width_px: int
    png_base64: str

    @classmethod
    def of(cls, picture: Picture) -> Drawn:
        """Draw a picture."""
        return cls(picture.title, picture.caption, picture.width_px, picture.png_base64)


@dataclass(frozen=True)
class ReportPage:
    """Content of a report, from top to bottom.

    Attributes:
        title: Name of the rig.
        subtitle: Date and source of the readings.
        verdict: Sentences with the main results; the first is printed large.
        warnings: Sentences that the reader must not overlook; without any, their box is left out.
        lead: Figures below the verdict, which show what it says at one look.
        tables: Tables below them.
        figures: Figures below the tables.
        appendix: Tables below the figures, with details.
        provenance: Command, versions, hashes, seed.
    """

    title: str
    subtitle: str
    verdict: Sequence[str]
    warnings: Sequence[str] = ()
    lead: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Picture] = ()
    appendix: Sequence[Table] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)


def render_report(page: ReportPage) -> str:
    """The page as HTML without references to other files; all text is escaped.

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
    drawn = in_forks(Drawn.of, [*page.lead, *page.figures])
    n_lead = len(page.lead)
    return templates.get_template("report.html.j2").render(
        page=page, lead=drawn[:n_lead], figures=drawn[n_lead:]
    )

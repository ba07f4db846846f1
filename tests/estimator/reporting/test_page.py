from __future__ import annotations

import base64
import io
import re
import struct
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from PIL import Image

from estimator.reporting.page import Picture, ReportPage, Table, render_report

NAUGHTY = '<script>alert("x")</script> & <b>'


def page() -> ReportPage:
    figure = Figure(figsize=(3.0, 2.0))
    figure.add_subplot().plot([0, 1])
    return ReportPage(
        title="rig a",
        subtitle="2026-01-01",
        verdict=["Predicts to 35 µT.", "Radius 51 mm."],
        warnings=["Spin is open."],
        lead=[Picture("Map", "It should be dark.", figure)],
        tables=[
            Table("Parameters", ["name", "median"], [["radius", "51.0 mm"], ["spin", "—"]], "What was found.")
        ],
        figures=[Picture("Residuals", "Look for drift.", figure)],
        provenance={"seed": "1"},
    )


class Tags(HTMLParser):
    """Checks that tags nest, and keeps them with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_report_says_everything_in_the_order_a_reader_needs():
    text = render_report(page())
    order = [
        "rig a</h1>",
        "2026-01-01",
        "Predicts",
        "Spin is open",
        "It should be dark",
        "Parameters",
        "51.0 mm",
        "Look for drift",
        "seed",
    ]
    offsets = [text.index(part) for part in order]
    assert offsets == sorted(offsets)
    Tags(text)


def test_a_report_needs_no_other_file():
    text = render_report(page())
    without_pictures = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"https?:|file:|//|@import|url\(", without_pictures)
    tags = Tags(text).seen
    assert not [tag for tag, _ in tags if tag in {"link", "script", "iframe", "object"}]
    sources = [attributes["src"] for _, attributes in tags if "src" in attributes]
    assert sources
    assert all(source and source.startswith("data:image/png;base64,") for source in sources)


def test_text_of_users_is_escaped_everywhere():
    figure = Figure(figsize=(1.0, 1.0))
    text = render_report(
        ReportPage(
            NAUGHTY,
            NAUGHTY,
            [NAUGHTY],
            [NAUGHTY],
            [Picture(f'{NAUGHTY}" onerror="x', NAUGHTY, figure)],
            [Table(NAUGHTY, [NAUGHTY], [[NAUGHTY]], NAUGHTY)],
            [Picture(f'{NAUGHTY}" onerror="x', NAUGHTY, figure)],
            [Table(NAUGHTY, [NAUGHTY], [[NAUGHTY]], NAUGHTY)],
            {NAUGHTY: NAUGHTY},
        )
    )
    assert "<script" not in text
    assert "<b>" not in text
    assert text.count("&lt;script&gt;") == 21
    assert not [attributes for _, attributes in Tags(text).seen if "onerror" in attributes]


def test_pictures_have_twice_the_pixels_they_are_shown_with_and_always_the_same_bytes():
    picture = page().figures[0]
    data = base64.b64decode(picture.png_base64)
    assert data.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", data[16:24])
    assert (width, height) == (2 * picture.width_px, 2 * 192)
    assert picture.png_base64 == page().figures[0].png_base64
    assert b"matplotlib" not in data.lower()


class Counted(Figure):
    """Counts how often it is drawn."""

    n_draws = 0

    def draw(self, renderer: RendererBase) -> None:
        self.n_draws += 1
        super().draw(renderer)


@pytest.mark.usefixtures("every_picture_is_drawn")
def test_a_picture_is_laid_out_and_drawn_in_one_go_and_leaves_its_figure_as_it_was():
    figure = Counted(figsize=(3.0, 2.0), layout="constrained")
    figure.add_subplot().set_ylabel("field (mT)")
    before = figure.dpi, figure.canvas
    assert Picture("", "", figure).png_base64
    assert figure.n_draws == 1
    assert (figure.dpi, figure.canvas) == before


def test_pictures_have_a_palette_and_look_as_they_were_drawn():
    picture = page().figures[0]
    stored = Image.open(io.BytesIO(base64.b64decode(picture.png_base64)))
    assert stored.mode == "P"
    drawn = io.BytesIO()
    picture.figure.savefig(drawn, format="png", dpi=192)
    difference = np.asarray(stored.convert("RGB"), float) - np.asarray(
        Image.open(drawn).convert("RGB"), float
    )
    assert np.abs(difference).mean() < 2.0  # of 255 levels

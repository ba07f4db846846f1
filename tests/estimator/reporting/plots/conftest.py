from __future__ import annotations

import io
from collections.abc import Callable

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

Words = Callable[[Axes | Figure], str]


@pytest.fixture
def words() -> Words:
    """Renders a plot and returns all that can be read on it; a warning while rendering fails the test."""

    def rendered(plot: Axes | Figure) -> str:
        figure = plot if isinstance(plot, Figure) else plot.figure
        figure.savefig(io.BytesIO(), format="png", dpi=50)
        return "\n".join(text.get_text() for text in figure.findobj(Text) if text.get_visible())

    return rendered

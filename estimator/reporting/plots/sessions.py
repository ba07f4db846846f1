"""One parameter after the other, session by session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from estimator.reporting.plots.style import GREY, POSTERIOR, TRUTH, figure, plain, shown, styled

MOST_ROWS = 60


@styled
def across_sessions(
    names: Sequence[str],
    median: Float[np.ndarray, "session parameter"],
    ci90: Float[np.ndarray, "session parameter 2"],
    labels: Sequence[str],
    is_sampled: Bool[np.ndarray, " session"],
    title: str = "",
) -> Figure:
    """Median and 90 % interval of every parameter for every session; the line is their mean, weighted by the intervals.

    Args:
        names: Of the parameters.
        median, ci90: In SI; NaN where a session has not got a parameter.
        labels: Of the sessions, from the top; the first 60 are drawn.
        is_sampled: Intervals from sampling are blue, those of the Laplace approximation grey.
        title: What the sessions are.
    """
    n = min(len(labels), MOST_ROWS)
    columns = min(len(names), 4)
    rows = -(-len(names) // columns)
    made = figure(0.9 + 2.5 * columns, rows * (0.9 + 0.2 * n) + 0.4, title)
    grid = made.subplots(rows, columns, squeeze=False, sharey=True)
    colours = [POSTERIOR if sampled else GREY for sampled in is_sampled[:n]]
    for ax, (name, show), i in zip(grid.flat, shown(names).items(), range(len(names)), strict=False):
        centre, ends = median[:n, i] * show.factor, ci90[:n, i] * show.factor
        y = np.arange(n)
        ax.hlines(y, ends[:, 0], ends[:, 1], colors=colours, lw=2.0)
        ax.scatter(centre, y, c=colours, s=14, zorder=3)
        width = ends[:, 1] - ends[:, 0]
        known = np.isfinite(centre) & (width > 0.0)
        if known.any():
            ax.axvline(float(np.average(centre[known], weights=width[known] ** -2.0)), color=TRUTH, lw=0.8)
        ax.set_xlabel(plain(show.label) if name else "")
        ax.set_yticks(y, [plain(label) for label in labels[:n]], fontsize=7)
        ax.set_ylim(n - 0.5, -0.5)
        ax.locator_params(axis="x", nbins=4)
    for ax in grid.flat[len(names) :]:
        ax.set_axis_off()
    return made

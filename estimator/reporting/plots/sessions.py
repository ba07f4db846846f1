"""Parameters of many sessions side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from estimator.reporting.numbers import displays, plain
from estimator.reporting.plots.style import GREY, POSTERIOR, TRUTH, figure, styled

MOST_ROWS = 60


@styled
def across_sessions(
    names: Sequence[str],
    median: Float[np.ndarray, "session parameter"],
    ci90: Float[np.ndarray, "session parameter 2"],
    labels: Sequence[str],
    is_sampled: Bool[np.ndarray, " session"],
) -> Figure:
    """Median and 90 % interval of every parameter for every session; the line is the mean, weighted by inverse squared width.

    Args:
        names: Names of the parameters.
        median, ci90: Medians and interval ends in SI; NaN if a session does not have the parameter.
        labels: Names of the sessions, from the top; the first 60 are drawn.
        is_sampled: Whether intervals come from sampling (blue) or from the Laplace approximation (grey).
    """
    n = min(len(labels), MOST_ROWS)
    columns = min(len(names), 4)
    rows = -(-len(names) // columns)
    fig = figure(0.9 + 2.5 * columns, rows * (0.9 + 0.2 * n) + 0.4)
    grid = fig.subplots(rows, columns, squeeze=False, sharey=True)
    colours = [POSTERIOR if sampled else GREY for sampled in is_sampled[:n]]
    for ax, (name, display), i in zip(grid.flat, displays(names).items(), range(len(names)), strict=False):
        centre, ends = median[:n, i] * display.factor, ci90[:n, i] * display.factor
        y = np.arange(n)
        ax.hlines(y, ends[:, 0], ends[:, 1], colors=colours, lw=2.0)
        ax.scatter(centre, y, c=colours, s=14, zorder=3)
        width = ends[:, 1] - ends[:, 0]
        has_interval = np.isfinite(centre) & (width > 0.0)
        if has_interval.any():
            mean = np.average(centre[has_interval], weights=width[has_interval] ** -2.0)
            ax.axvline(float(mean), color=TRUTH, lw=0.8)
        ax.set_xlabel(plain(display.label) if name else "")
        ax.set_yticks(y, [plain(label) for label in labels[:n]], fontsize=7)
        ax.set_ylim(n - 0.5, -0.5)
        ax.locator_params(axis="x", nbins=4)
    for ax in grid.flat[len(names) :]:
        ax.set_axis_off()
    return fig

"""Corner plot: marginal distributions on the diagonal, joint distributions of pairs below it.

Draws that are all whole numbers are loop counts. They are drawn as bars, since a density
would suggest values in between.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Num
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from estimator.reporting.numbers import Display, are_counts, displays, summary
from estimator.reporting.plots.style import (
    INSIDE_68,
    INSIDE_95,
    OUTSIDE,
    POINT,
    QUANTILES_95_68_50,
    TRUTH,
    figure,
    styled,
)

BINS = 36
LABEL_SIZE, POINTS_PER_INCH = 9, 72
LETTER = 0.62  # width of a letter over its size
PANEL_SHARE = 0.75  # of the cell that a panel fills, ticks aside
SMOOTHING_BINS = 1.2
DRAWN_QUANTILES = (0.002, 0.998)
SMALLEST_PROBABILITY = 0.002  # of a count that is drawn


@styled
def corner(
    draws: Mapping[str, Num[np.ndarray, " draw"]],
    truth: Mapping[str, float] | None = None,
    point: Mapping[str, float] | None = None,
    title: str = "",
) -> Figure:
    """Histograms with 68 and 95 % credible intervals, and 68 and 95 % credible regions of every pair.

    Args:
        draws: Posterior draws by parameter name, SI.
        truth: True values of a simulation, by name; parameters without one are not marked.
        point: Point estimate, by name.
        title: Rig and date.
    """
    marks = [(values, colour) for values, colour in ((point or {}, POINT), (truth or {}, TRUTH))]
    columns = []
    for name, display in displays(list(draws)).items():
        marked = [(values[name] * display.factor, colour) for values, colour in marks if name in values]
        columns.append(_Column.of(np.asarray(draws[name], dtype=float) * display.factor, display, marked))
    n = len(columns)
    size = min(max(4.6, 1.35 * n), 14.0)
    fig = figure(size, size, title)
    grid = fig.add_gridspec(n, n, wspace=0.04, hspace=0.04)
    left, below = list[Axes](), list[Axes]()  # panels with labels
    for i, row in enumerate(columns):
        for j, column in enumerate(columns[: i + 1]):
            ax = fig.add_subplot(grid[i, j])
            if i == j:
                _diagonal(ax, column)
            else:
                _pair(ax, column, row)
                _y_axis(ax, row, _wrapped(row.display.label, size / n) if j == 0 else "")
            _x_axis(ax, column, _wrapped(column.display.label, size / n) if i == n - 1 else "")
            left += [ax] if j == 0 else []
            below += [ax] if i == n - 1 else []
    # Of all panels `align_labels` would compare the ticks with those of each other one, a third of the time of the figure.
    fig.align_ylabels(left)
    fig.align_xlabels(below)
    handles: list[Patch | Line2D] = [Patch(color=INSIDE_68, label="68 %")]
    handles.append(Patch(color=INSIDE_95, label="95 %"))
    if point:
        handles.append(Line2D([], [], color=POINT, ls=_dash(POINT), label="point estimate"))
    if truth:
        handles.append(Line2D([], [], color=TRUTH, ls=_dash(TRUTH), label="truth"))
    if n > 2:
        fig.legend(handles=handles, loc="upper right", bbox_to_anchor=(1.0, 0.94), fontsize=10)
    else:
        fig.legend(handles=handles, loc="outside right upper")
    return fig


@dataclass(frozen=True)
class _Column:
    """A parameter in its display unit: draws, axis limits, and marked values with their colours."""

    values: np.ndarray
    display: Display
    is_count: bool
    low: float
    high: float
    marks: list[tuple[float, str]]

    @classmethod
    def of(cls, values: np.ndarray, display: Display, marks: list[tuple[float, str]]) -> _Column:
        is_count = are_counts(values, display)
        low, high = np.quantile(values, DRAWN_QUANTILES)
        low, high = min(low, *(at for at, _ in marks), low), max(high, *(at for at, _ in marks), high)
        margin = 0.7 if is_count else 0.06 * (high - low) or 1e-6 * max(abs(high), 1.0)
        return cls(values, display, is_count, float(low - margin), float(high + margin), marks)


def _diagonal(ax: Axes, column: _Column) -> None:
    if column.is_count:
        counts, probability = _probabilities(column.values[:, None])
        ax.bar(counts[:, 0], probability, 0.8, color=_credible_set_colours(probability))
    else:
        number, edges = np.histogram(column.values, BINS, (column.low, column.high))
        low95, low68, _, high68, high95 = np.quantile(column.values, QUANTILES_95_68_50)
        centre = 0.5 * (edges[1:] + edges[:-1])
        is_68, is_95 = (centre > low68) & (centre < high68), (centre > low95) & (centre < high95)
        colours = np.where(is_68, INSIDE_68, np.where(is_95, INSIDE_95, OUTSIDE))
        ax.bar(centre, number, np.diff(edges), color=list(colours))
    for at, colour in column.marks:
        ax.axvline(at, color=colour, lw=1.2, ls=_dash(colour))
    ax.set_title(summary(column.values, column.display), fontsize=8)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)


def _pair(ax: Axes, column: _Column, row: _Column) -> None:
    if column.is_count and row.is_count:
        pairs, probability = _probabilities(np.stack((column.values, row.values), axis=1))
        size = 160.0 * probability / probability.max()
        ax.scatter(pairs[:, 0], pairs[:, 1], size, _credible_set_colours(probability), marker="s")
    elif column.is_count or row.is_count:
        count, continuous = (column, row) if column.is_count else (row, column)
        _strips(ax, count.values, continuous.values, is_upright=column.is_count)
    else:
        _contours(ax, column, row)
    for at, colour in column.marks:
        ax.axvline(at, color=colour, lw=0.9, ls=_dash(colour))
    for at, colour in row.marks:
        ax.axhline(at, color=colour, lw=0.9, ls=_dash(colour))


def _contours(ax: Axes, column: _Column, row: _Column) -> None:
    limits = ((column.low, column.high), (row.low, row.high))
    number, x, y = np.histogram2d(column.values, row.values, BINS, limits)
    density = gaussian_filter(number, SMOOTHING_BINS)
    ranked = np.sort(density, axis=None)[::-1]
    mass = np.cumsum(ranked) / ranked.sum()
    level_68, level_95 = (ranked[np.searchsorted(mass, p)] for p in (0.68, 0.95))
    if 0.0 < level_95 < level_68 < ranked[0]:
        centres = 0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])
        ax.contourf(*centres, density.T, [level_95, level_68, ranked[0]], colors=[INSIDE_95, INSIDE_68])


def _strips(ax: Axes, counts: np.ndarray, continuous: np.ndarray, is_upright: bool) -> None:
    """Intervals of a continuous parameter at every count; the less probable the count, the fainter."""
    draw = ax.vlines if is_upright else ax.hlines
    values, probability = _probabilities(counts[:, None])
    for at, p in zip(values[:, 0], probability, strict=True):
        if p > SMALLEST_PROBABILITY:
            low95, low68, _, high68, high95 = np.quantile(continuous[counts == at], QUANTILES_95_68_50)
            alpha = 0.25 + 0.75 * p / probability.max()
            draw(at, low95, high95, color=INSIDE_95, lw=5, alpha=alpha)
            draw(at, low68, high68, color=INSIDE_68, lw=5, alpha=alpha)


def _probabilities(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values, number = np.unique(counts, axis=0, return_counts=True)
    return values, number / number.sum()


def _credible_set_colours(probability: np.ndarray) -> list[str]:
    """Colours of the 68 and 95 % credible sets: the most probable values first."""
    order = np.argsort(-probability, kind="stable")
    more_probable = np.empty_like(probability)
    more_probable[order] = np.cumsum(probability[order]) - probability[order]
    return list(np.where(more_probable < 0.68, INSIDE_68, np.where(more_probable < 0.95, INSIDE_95, OUTSIDE)))


def _dash(colour: str) -> str:
    return ":" if colour == POINT else "-"


def _wrapped(label: str, cell_in: float) -> str:
    """A label in lines no longer than a panel, so that it does not reach into the label beside it."""
    most = max(6, int(PANEL_SHARE * cell_in * POINTS_PER_INCH / (LETTER * LABEL_SIZE)))
    return "\n".join(textwrap.wrap(label.replace("[", " ["), most))


def _x_axis(ax: Axes, column: _Column, label: str) -> None:
    ax.set_xlim(column.low, column.high)
    if label:
        ax.xaxis.set_major_locator(MaxNLocator(3, integer=column.is_count))
        ax.set_xlabel(label, fontsize=LABEL_SIZE)
        ax.tick_params(axis="x", rotation=45, labelsize=8)
    else:
        ax.set_xticks([])  # half of the time of the figure goes into ticks


def _y_axis(ax: Axes, row: _Column, label: str) -> None:
    ax.set_ylim(row.low, row.high)
    if label:
        ax.yaxis.set_major_locator(MaxNLocator(3, integer=row.is_count))
        ax.set_ylabel(label, fontsize=LABEL_SIZE)
        ax.tick_params(axis="y", labelsize=8)
    else:
        ax.set_yticks([])

"""Corner plot: every parameter's distribution on the diagonal, every pair's below it.

Draws that are all whole numbers are loop counts and are drawn as bars: a density
would suggest values in between.
"""

from __future__ import annotations

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

from estimator.reporting.plots.style import (
    INSIDE_68,
    INSIDE_95,
    OUTSIDE,
    POINT,
    QUANTILES_95_68_50,
    TRUTH,
    Shown,
    are_counts,
    figure,
    shown,
    styled,
    summary,
)

BINS = 36
SMOOTHING_BINS = 1.2
REACH = (0.002, 0.998)
RAREST = 0.002


@styled
def corner(
    draws: Mapping[str, Num[np.ndarray, " draw"]],
    truth: Mapping[str, float] | None = None,
    point: Mapping[str, float] | None = None,
    title: str = "",
) -> Figure:
    """Histograms with 68 and 95 % intervals, and the 68 and 95 % regions of every pair.

    Args:
        draws: Posterior draws by parameter name, SI.
        truth: Values that a simulation used, by name; names missing here are not marked.
        point: The point estimate, likewise.
        title: Rig and date.
    """
    marks = [(values, colour) for values, colour in ((point or {}, POINT), (truth or {}, TRUTH))]
    columns = []
    for name, show in shown(list(draws)).items():
        at = [(values[name] * show.factor, colour) for values, colour in marks if name in values]
        columns.append(_Column.of(np.asarray(draws[name], dtype=float) * show.factor, show, at))
    n = len(columns)
    size = min(max(4.6, 1.35 * n), 14.0)
    made = figure(size, size, title)
    grid = made.subplots(n, n, squeeze=False, gridspec_kw={"wspace": 0.04, "hspace": 0.04})
    for i, row in enumerate(columns):
        for j, column in enumerate(columns):
            if j > i:
                grid[i, j].remove()
            elif i == j:
                _diagonal(grid[i, i], column)
                _across(grid[i, i], column, has_labels=i == n - 1)
            else:
                _pair(grid[i, j], column, row)
                _across(grid[i, j], column, has_labels=i == n - 1)
                _upwards(grid[i, j], row, has_labels=j == 0)
    made.align_labels()
    handles: list[Patch | Line2D] = [Patch(color=INSIDE_68, label="68 %")]
    handles.append(Patch(color=INSIDE_95, label="95 %"))
    if point:
        handles.append(Line2D([], [], color=POINT, ls=_dash(POINT), label="point estimate"))
    if truth:
        handles.append(Line2D([], [], color=TRUTH, ls=_dash(TRUTH), label="truth"))
    if n > 2:
        made.legend(handles=handles, loc="upper right", bbox_to_anchor=(1.0, 0.94), fontsize=10)
    else:
        made.legend(handles=handles, loc="outside right upper")
    return made


@dataclass(frozen=True)
class _Column:
    """One parameter as it is drawn: values in its display unit, limits, marked values with their colours."""

    values: np.ndarray
    show: Shown
    is_count: bool
    low: float
    high: float
    marks: list[tuple[float, str]]

    @classmethod
    def of(cls, values: np.ndarray, show: Shown, marks: list[tuple[float, str]]) -> _Column:
        is_count = are_counts(values, show)
        low, high = np.quantile(values, REACH)
        low, high = min(low, *(at for at, _ in marks), low), max(high, *(at for at, _ in marks), high)
        margin = 0.7 if is_count else 0.06 * (high - low) or 1e-6 * max(abs(high), 1.0)
        return cls(values, show, is_count, float(low - margin), float(high + margin), marks)


def _diagonal(ax: Axes, column: _Column) -> None:
    if column.is_count:
        counts, probability = _probabilities(column.values[:, None])
        ax.bar(counts[:, 0], probability, 0.8, color=_set_colours(probability))
    else:
        number, edges = np.histogram(column.values, BINS, (column.low, column.high))
        low95, low68, _, high68, high95 = np.quantile(column.values, QUANTILES_95_68_50)
        centre = 0.5 * (edges[1:] + edges[:-1])
        is_68, is_95 = (centre > low68) & (centre < high68), (centre > low95) & (centre < high95)
        colours = np.where(is_68, INSIDE_68, np.where(is_95, INSIDE_95, OUTSIDE))
        ax.bar(centre, number, np.diff(edges), color=list(colours))
    for at, colour in column.marks:
        ax.axvline(at, color=colour, lw=1.2, ls=_dash(colour))
    ax.set_title(summary(column.values, column.show), fontsize=8)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)


def _pair(ax: Axes, column: _Column, row: _Column) -> None:
    if column.is_count and row.is_count:
        pairs, probability = _probabilities(np.stack((column.values, row.values), axis=1))
        size = 160.0 * probability / probability.max()
        ax.scatter(pairs[:, 0], pairs[:, 1], size, _set_colours(probability), marker="s")
    elif column.is_count or row.is_count:
        counted, other = (column, row) if column.is_count else (row, column)
        _strips(ax, counted.values, other.values, is_upright=column.is_count)
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


def _strips(ax: Axes, counts: np.ndarray, others: np.ndarray, is_upright: bool) -> None:
    """The other parameter's intervals at every whole number, fainter where that number is less probable."""
    draw = ax.vlines if is_upright else ax.hlines
    values, probability = _probabilities(counts[:, None])
    for at, p in zip(values[:, 0], probability, strict=True):
        if p > RAREST:
            low95, low68, _, high68, high95 = np.quantile(others[counts == at], QUANTILES_95_68_50)
            alpha = 0.25 + 0.75 * p / probability.max()
            draw(at, low95, high95, color=INSIDE_95, lw=5, alpha=alpha)
            draw(at, low68, high68, color=INSIDE_68, lw=5, alpha=alpha)


def _probabilities(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values, number = np.unique(counts, axis=0, return_counts=True)
    return values, number / number.sum()


def _set_colours(probability: np.ndarray) -> list[str]:
    """The most probable values until 68 and 95 % are reached."""
    order = np.argsort(-probability, kind="stable")
    before = np.empty_like(probability)
    before[order] = np.cumsum(probability[order]) - probability[order]
    return list(np.where(before < 0.68, INSIDE_68, np.where(before < 0.95, INSIDE_95, OUTSIDE)))


def _dash(colour: str) -> str:
    return ":" if colour == POINT else "-"


def _across(ax: Axes, column: _Column, has_labels: bool) -> None:
    ax.set_xlim(column.low, column.high)
    ax.xaxis.set_major_locator(MaxNLocator(3, integer=column.is_count))
    if has_labels:
        ax.set_xlabel(column.show.label)
        ax.tick_params(axis="x", rotation=45, labelsize=8)
    else:
        ax.tick_params(labelbottom=False)


def _upwards(ax: Axes, row: _Column, has_labels: bool) -> None:
    ax.set_ylim(row.low, row.high)
    ax.yaxis.set_major_locator(MaxNLocator(3, integer=row.is_count))
    if has_labels:
        ax.set_ylabel(row.show.label)
        ax.tick_params(axis="y", labelsize=8)
    else:
        ax.tick_params(labelleft=False)

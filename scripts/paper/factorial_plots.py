"""Sensitivity of the field: main effects and interactions of a full factorial, as in Fig 8 of the paper."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.reporting.numbers import Display, displays
from estimator.reporting.plots.style import BLUE, FIELD_MAP, GREY, axes, figure, styled
from estimator.units import UNITS
from scripts.paper.factorial import Factorial

MILLI = UNITS["mT"].to_si


@styled
def main_effect(factorial: Factorial, name: str, ax: Axes | None = None) -> Axes:
    """Mean response at each level of one parameter, with the 95 % band over all other levels; dotted: the overall mean."""
    ax = axes(ax, 3.4, 2.8)
    display = displays(factorial.names)[name]
    across = factorial.levels[factorial.names.index(name)] * display.factor
    other_axes = tuple(i for i, axis_name in enumerate(factorial.names) if axis_name != name)
    low, high = (np.quantile(factorial.response, q, axis=other_axes) / MILLI for q in (0.025, 0.975))
    ax.fill_between(across, low, high, color=GREY, alpha=0.25, lw=0, label="central 95 % of runs")
    ax.plot(across, factorial.main_effect(name) / MILLI, color=BLUE, marker="o", ms=4, label="mean")
    ax.axhline(factorial.response.mean() / MILLI, color=GREY, lw=0.8, ls=":")
    ax.set_xlabel(display.label)
    ax.set_ylabel(f"{factorial.label} (mT)")
    return ax


@styled
def main_effects(factorial: Factorial, title: str = "") -> Figure:
    """Main effect of every parameter on one scale."""
    fig = figure(2.6 * len(factorial.names), 2.8, title)
    first: Axes | None = None
    for i, name in enumerate(factorial.names):
        ax = fig.add_subplot(1, len(factorial.names), i + 1, sharey=first)
        main_effect(factorial, name, ax)
        if first is None:
            first = ax
            ax.legend(fontsize=7)
        else:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)
    return fig


@styled
def interaction(factorial: Factorial, across: str, line: str, ax: Axes | None = None) -> Axes:
    """Mean response along one parameter, a line for each level of another; parallel lines mean no interaction."""
    ax = axes(ax, 3.0, 2.6)
    display = displays(factorial.names)
    x = factorial.levels[factorial.names.index(across)] * display[across].factor
    levels = factorial.levels[factorial.names.index(line)]
    table = factorial.interaction(line, across) / MILLI
    colours = colormaps[FIELD_MAP](np.linspace(0.0, 0.9, len(levels)))
    for row, level, colour in zip(table, levels, colours, strict=True):
        ax.plot(x, row, color=colour, lw=1.0, label=_level_text(level, display[line]))
    ax.set_xlabel(display[across].label)
    ax.set_ylabel(f"{factorial.label} (mT)")
    return ax


@styled
def interactions(factorial: Factorial, title: str = "") -> Figure:
    """All pairs of parameters on one scale, with main effects on the diagonal; each row has a parameter's levels as lines."""
    n = len(factorial.names)
    fig = figure(2.3 * n + 1.0, 2.1 * n, title)
    panels = fig.subplots(n, n, sharex="col", sharey=True, squeeze=False)
    for line, row in zip(factorial.names, panels, strict=True):
        for across, ax in zip(factorial.names, row, strict=True):
            if line == across:
                main_effect(factorial, line, ax)
            else:
                interaction(factorial, across, line, ax)
        lines = row[1 if line == factorial.names[0] else 0].lines
        row[-1].legend(
            handles=lines,
            title=displays(factorial.names)[line].label,
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            fontsize=7,
            title_fontsize=8,
        )
        for ax in row:
            ax.label_outer()
    return fig


def _level_text(level: float, display: Display) -> str:
    return f"{level * display.factor:.4g}".replace("-", "−")

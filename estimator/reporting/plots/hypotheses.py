"""Competing hypotheses: log evidence of each, residual explained by the adopted ones, and structure of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.reporting.numbers import plain
from estimator.reporting.plots.style import (
    BLACK,
    BLUE,
    COMPONENT,
    COMPONENT_MARKER,
    GREY,
    NOISE,
    ORANGE,
    PALE,
    axes,
    figure,
    sigma_unit,
    styled,
)

MOST_BARS = 10
LEAST_P = 1e-4
CLEAR = 3.0  # log Bayes factor, about 20 to 1
BINS = 12


@styled
def evidence_bars(
    evidence: Mapping[str, float], adopted: str | None = None, ax: Axes | None = None, title: str = ""
) -> Axes:
    """Log Bayes factors of hypotheses against "nothing", best on top; the adopted one in colour.

    Args:
        evidence: Log Bayes factors by name; `nothing` is 0 by definition, and worse hypotheses are drawn to its left.
        adopted: The hypothesis that was adopted; None if none was.
        ax: Axes to draw into; a new figure by default.
        title: Rig and step.
    """
    names = sorted(evidence, key=lambda name: -evidence[name])[:MOST_BARS]
    names += [name for name in ("nothing", "unexplained") if name in evidence and name not in names]
    ax = axes(ax, 6.4, 0.9 + 0.26 * len(names))
    best = max(evidence.values())
    least = -0.25 * max(best, 4.0)
    for row, name in enumerate(names):
        value = max(evidence[name], least)
        colour = BLUE if name == adopted else ORANGE if name == "unexplained" else GREY
        ax.barh(row, value, color=colour, height=0.7)
        if name != "nothing":
            text = f"{round(evidence[name], 1) + 0.0:.1f}" if evidence[name] >= least else f"< {least:.0f}"
            ax.annotate(
                f" {text}".replace("-", "−"), (max(value, 0.0), row), va="center", ha="left", fontsize=8
            )
    ax.axvline(0.0, color=BLACK, lw=0.8)
    ax.axvspan(best - CLEAR, best, color=NOISE, zorder=0, lw=0)
    ax.set_yticks(range(len(names)), [plain(name) for name in names])
    ax.invert_yaxis()
    ax.set_xlim(least, 1.15 * max(best, 4.0))
    ax.set_xlabel("log Bayes factor against “nothing”; grey band: within 20 to 1 of the best")
    ax.set_title(plain(title))
    return ax


@styled
def stepwise_residual(
    names: Sequence[str],
    rms_T: Sequence[float],
    evidence: Sequence[float],
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Residual that remains as causes are added one after another, first on top.

    Args:
        names: Names of the causes, in the order in which they were adopted.
        rms_T: Rms residual per component before any cause, then after each; one more than names.
        evidence: Increase of the log evidence of the fit by each cause.
        ax: Axes to draw into; a new figure by default.
        title: Rig.
    """
    ax = axes(ax, 6.4, 1.2 + 0.26 * len(rms_T))
    for row, value_T in enumerate(rms_T):
        ax.barh(row, 1e6 * value_T, color=BLUE if row else GREY, height=0.7)
        number = f"{1e6 * value_T:.3g}" if value_T < 1e-3 else f"{1e6 * value_T:.0f}"
        text = f"  {number} µT" + (f", log evidence +{evidence[row - 1]:.0f}" if row else "")
        ax.annotate(text, (1e6 * value_T, row), va="center", ha="left", fontsize=8)
    labels = ["rig as described", *(f"+ {name}" for name in names)]
    ax.set_yticks(range(len(rms_T)), [plain(label) for label in labels])
    ax.invert_yaxis()
    ax.set_xlim(0.0, 1.45e6 * max(rms_T))
    ax.set_xlabel("rms residual per component, readings used in the search (µT)")
    ax.set_title(plain(title))
    return ax


@styled
def explained_residual(
    residual_T: Float[np.ndarray, "reading 3"],
    explained_T: Float[np.ndarray, "reading 3"],
    sigma_T: float | Float[np.ndarray, "reading 3"],
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Residual of the rig as described against the change in prediction by added causes; right causes put points on the line.

    Args:
        residual_T: Measured minus predicted, without the causes.
        explained_T: Predicted with the causes minus predicted without.
        sigma_T: One standard deviation of the noise of a component.
        ax: Axes to draw into; a new figure by default.
        title: Rig and causes.
    """
    ax = axes(ax, 5.6, 4.4)
    divisor, band, unit = sigma_unit(sigma_T)
    across, up = explained_T / divisor, residual_T / divisor
    low, high = float(np.nanmin(across)), float(np.nanmax(across))
    line = np.array([low, high])
    ax.fill_between(line, line - band, line + band, color=NOISE, lw=0, label="± 1 sigma of the noise")
    ax.plot(line, line, color=BLACK, lw=0.9, label="fully explained")
    ax.axhline(0.0, color=GREY, lw=0.8, ls=":", label="not explained")
    for i, name in enumerate(COMPONENT):
        if np.isfinite(up[:, i]).any():
            ax.plot(
                across[:, i],
                up[:, i],
                ls="",
                marker=COMPONENT_MARKER[name],
                ms=3,
                alpha=0.45,
                mew=0,
                color=COMPONENT[name],
                label=f"B{name}",
            )
    centre, mean, error = _binned(across.ravel(), up.ravel())
    ax.errorbar(
        centre,
        mean,
        yerr=error,
        color=BLACK,
        marker="D",
        ms=4,
        lw=0,
        elinewidth=1.2,
        label="mean ± standard error",
    )
    largest = np.nanquantile(np.abs(up), 0.995)
    ax.set(ylim=(-1.1 * largest, 1.1 * largest))
    ax.set_xlabel(f"change in prediction by the added causes ({unit})")
    ax.set_ylabel(f"residual without them ({unit})")
    ax.set_title(plain(title))
    ax.legend(fontsize=8, loc="upper left", ncols=2)
    return ax


@styled
def structure_bars(
    names: Sequence[str],
    before: Sequence[float],
    after: Sequence[float],
    title: str = "",
) -> Figure:
    """Significance of the residual's structure along each covariate, before and after causes were added.

    Args:
        names: Names of the covariates.
        before, after: p-value of each, corrected for testing all of them.
        title: Rig and date.
    """
    fig = figure(6.8, 1.2 + 0.3 * len(names), title)
    ax = fig.add_subplot()
    row = np.arange(len(names))
    for shift, values, colour, label in ((-0.2, before, ORANGE, "before"), (0.2, after, BLUE, "after")):
        height = -np.log10(np.maximum(np.asarray(values), LEAST_P))
        ax.barh(row + shift, height, height=0.38, color=colour, label=label)
    ax.axvspan(0.0, -np.log10(0.05), color=PALE, zorder=0, lw=0, label="consistent with noise (p > 0.05)")
    ax.set_yticks(row, [plain(name) for name in names])
    ax.invert_yaxis()
    ticks = np.arange(0, 5)
    ax.set_xticks(ticks, ["1", "0.1", "0.01", "0.001", "0.0001"])
    ax.set_xlabel("p-value, corrected for testing all covariates (smaller to the right)")
    ax.legend(fontsize=8, loc="lower right")
    return fig


def _binned(across: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre, mean and standard error in bins of equal number along the horizontal axis."""
    is_finite = np.isfinite(across) & np.isfinite(up)
    x, y = across[is_finite], up[is_finite]
    bins = [rows for rows in np.array_split(np.argsort(x, kind="stable"), BINS) if len(rows) > 2]
    centre = np.array([x[rows].mean() for rows in bins])
    mean = np.array([y[rows].mean() for rows in bins])
    error = np.array([y[rows].std(ddof=1) / np.sqrt(len(rows)) for rows in bins])
    return centre, mean, error

"""Competing hypotheses: how strongly the readings speak for each, what the winner explains, and along what the residual had structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
    plain,
    sigma_unit,
    styled,
)

MOST_BARS = 10
LEAST_P = 1e-4
CLEAR = 3.0  # log evidence, about 20 to 1
BINS = 12


@styled
def evidence_bars(
    evidence: Mapping[str, float], taken: str | None = None, ax: Axes | None = None, title: str = ""
) -> Axes:
    """Log evidence of hypotheses against "nothing", best on top; the one that was taken in colour.

    Args:
        evidence: By name; `nothing` is 0 by definition, and those below it are drawn to its left.
        taken: The hypothesis that was adopted; None where none was.
        ax: Place; a new figure by default.
        title: Rig and step.
    """
    shown = sorted(evidence, key=lambda name: -evidence[name])[:MOST_BARS]
    for kept in ("nothing", "unexplained"):
        if kept in evidence and kept not in shown:
            shown.append(kept)
    ax = axes(ax, 6.4, 0.9 + 0.26 * len(shown))
    best = max(evidence.values())
    least = -0.25 * max(best, 4.0)
    for row, name in enumerate(shown):
        value = max(evidence[name], least)
        colour = BLUE if name == taken else ORANGE if name == "unexplained" else GREY
        ax.barh(row, value, color=colour, height=0.7)
        if name != "nothing":
            says = f"{round(evidence[name], 1) + 0.0:.1f}" if evidence[name] >= least else f"< {least:.0f}"
            ax.annotate(
                f" {says}".replace("-", "−"), (max(value, 0.0), row), va="center", ha="left", fontsize=8
            )
    ax.axvline(0.0, color=BLACK, lw=0.8)
    ax.axvspan(best - CLEAR, best, color=NOISE, zorder=0, lw=0)
    ax.set_yticks(range(len(shown)), [plain(name) for name in shown])
    ax.invert_yaxis()
    ax.set_xlim(least, 1.15 * max(best, 4.0))
    ax.set_xlabel("log evidence against nothing; grey band: within 20 to 1 of the best")
    ax.set_title(plain(title))
    return ax


@styled
def ladder(
    names: Sequence[str],
    rms_T: Sequence[float],
    evidence: Sequence[float],
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Residual that was left as causes were added one after another, first on top.

    Args:
        names: Of the causes, in the order in which they were taken.
        rms_T: Residual of a component before any cause, then after each; one more than names.
        evidence: What the log evidence of the fit gained by each cause.
        ax: Place; a new figure by default.
        title: Rig.
    """
    ax = axes(ax, 6.4, 1.2 + 0.26 * len(rms_T))
    for row, value_T in enumerate(rms_T):
        ax.barh(row, 1e6 * value_T, color=BLUE if row else GREY, height=0.7)
        shown = f"{1e6 * value_T:.3g}" if value_T < 1e-3 else f"{1e6 * value_T:.0f}"
        says = f"  {shown} µT" + (f", log evidence +{evidence[row - 1]:.0f}" if row else "")
        ax.annotate(says, (1e6 * value_T, row), va="center", ha="left", fontsize=8)
    labels = ["as described", *(f"+ {name}" for name in names)]
    ax.set_yticks(range(len(rms_T)), [plain(label) for label in labels])
    ax.invert_yaxis()
    ax.set_xlim(0.0, 1.45e6 * max(rms_T))
    ax.set_xlabel("rms residual of a component in the readings of the search (µT)")
    ax.set_title(plain(title))
    return ax


@styled
def explained(
    residual_T: Float[np.ndarray, "reading 3"],
    explained_T: Float[np.ndarray, "reading 3"],
    sigma_T: float | Float[np.ndarray, "reading 3"],
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Residual before the extension over what the extension changes: points lie about the line where it is right.

    Args:
        residual_T: Measured minus predicted before.
        explained_T: Predicted after minus predicted before.
        sigma_T: Noise of a component.
        ax: Place; a new figure by default.
        title: Rig and causes.
    """
    ax = axes(ax, 5.6, 4.4)
    divisor, band, unit = sigma_unit(sigma_T)
    across, up = explained_T / divisor, residual_T / divisor
    low, high = float(np.nanmin(across)), float(np.nanmax(across))
    line = np.array([low, high])
    ax.fill_between(line, line - band, line + band, color=NOISE, lw=0, label="± 1 sigma of the noise")
    ax.plot(line, line, color=BLACK, lw=0.9, label="wholly explained")
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
        centre, mean, yerr=error, color=BLACK, marker="D", ms=4, lw=0, elinewidth=1.2, label="mean ± error"
    )
    shown = np.nanquantile(np.abs(up), 0.995)
    ax.set(ylim=(-1.1 * shown, 1.1 * shown))
    ax.set_xlabel(f"what the extension changes ({unit})")
    ax.set_ylabel(f"residual before ({unit})")
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
    """How surely the residual follows each covariate, before and after: p-values over all covariates together.

    Args:
        names: Of the covariates.
        before, after: p-values of each.
        title: Rig and date.
    """
    made = figure(6.8, 1.2 + 0.3 * len(names), title)
    ax = made.add_subplot()
    row = np.arange(len(names))
    for shift, values, colour, label in ((-0.2, before, ORANGE, "before"), (0.2, after, BLUE, "after")):
        height = -np.log10(np.maximum(np.asarray(values), LEAST_P))
        ax.barh(row + shift, height, height=0.38, color=colour, label=label)
    ax.axvspan(0.0, -np.log10(0.05), color=PALE, zorder=0, lw=0, label="as noise would (p > 0.05)")
    ax.set_yticks(row, [plain(name) for name in names])
    ax.invert_yaxis()
    ticks = np.arange(0, 5)
    ax.set_xticks(ticks, ["1", "0.1", "0.01", "0.001", "0.0001"])
    ax.set_xlabel("p-value over all covariates together (smaller to the right)")
    ax.legend(fontsize=8, loc="lower right")
    return made


def _binned(across: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and its standard error in bins of equal number along the horizontal axis."""
    known = np.isfinite(across) & np.isfinite(up)
    order = np.argsort(across[known], kind="stable")
    groups = [part for part in np.array_split(order, BINS) if len(part) > 2]
    x, y = across[known], up[known]
    centre = np.array([x[part].mean() for part in groups])
    mean = np.array([y[part].mean() for part in groups])
    error = np.array([y[part].std(ddof=1) / np.sqrt(len(part)) for part in groups])
    return centre, mean, error

"""Competing hypotheses: log evidence of each, residual explained by the adopted ones, and structure of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from estimator.reporting.numbers import plain
from estimator.reporting.plots import style
from estimator.reporting.roles import Role

MOST_BARS = 10
LEAST_P = 1e-4
ROUNDING = 1e-9
CLEAR = 3.0  # log Bayes factor, about 20 to 1
BINS = 12


COLOUR = {
    Role.NAMED: style.BLUE,
    Role.ALTERNATIVE: style.INSIDE_95,
    Role.STAND_IN: style.PURPLE,
    Role.OTHER: style.GREY,
    Role.LEFT: style.ORANGE,
}
HATCH = {Role.STAND_IN: "///"}
ALWAYS_DRAWN = (Role.ALTERNATIVE, Role.LEFT)
WORDS = {"nothing": "nothing wrong", "unexplained": "something unlisted"}


@style.styled
def evidence_bars(
    evidence: Mapping[str, float],
    adopted: str | None = None,
    roles: Mapping[str, Role] | None = None,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Log Bayes factors of hypotheses against "nothing", in groups by role, the best of each on top.

    Args:
        evidence: Log Bayes factors by name; `nothing` is 0 by definition, and worse hypotheses are drawn to its left.
        adopted: The hypothesis that was adopted; None if none was.
        roles: Of some hypotheses; by default the adopted one is named, `unexplained` is what is left, and the others are not needed.
        ax: Axes to draw into; a new figure by default.
        title: Rig and step.
    """
    role = dict.fromkeys(evidence, Role.OTHER) | {"unexplained": Role.LEFT}
    role |= roles if roles is not None else {} if adopted is None else {adopted: Role.NAMED}
    shown = sorted(evidence, key=lambda name: -evidence[name])[:MOST_BARS]
    always = {"nothing", adopted} | {name for name in evidence if role[name] in ALWAYS_DRAWN}
    shown += [name for name in evidence if name in always and name not in shown]
    groups = [[name for name in shown if role[name] is kind] for kind in Role]
    names = [name for group in groups for name in group]
    begins = [0.5 * sum(map(bool, groups[: list(Role).index(role[name])])) for name in names]
    rows = [i + begin for i, begin in enumerate(begins)]
    ax = style.axes(ax, 6.4, 1.2 + 0.26 * (rows[-1] + 1.0))
    best = max(evidence.values())
    least = -0.25 * max(best, 4.0)
    for row, name in zip(rows, names, strict=True):
        value = max(evidence[name], least)
        _bar(ax, row, value, role[name])
        if name != "nothing":
            text = f"{round(evidence[name], 1) + 0.0:.1f}" if evidence[name] >= least else f"< {least:.0f}"
            text = f" {text}".replace("-", "−") + ("  ← stated" if name == adopted else "")
            ax.annotate(text, (max(value, 0.0), row), va="center", ha="left", fontsize=8)
    ax.axvline(0.0, color=style.BLACK, lw=0.8)
    ax.axvspan(best - CLEAR, best, color=style.NOISE, zorder=0, lw=0, label="within 20 to 1 of the best")
    ax.set_yticks(rows, [plain(WORDS.get(name, name)) for name in names])
    ax.invert_yaxis()
    ax.set_xlim(least, 1.35 * max(best, 4.0))
    ax.set_xlabel("log Bayes factor against “nothing wrong”")
    ax.set_title(plain(title))
    _legend(ax, [role[name] for name in names])
    return ax


@style.styled
def error_budget(
    shares: Mapping[str, tuple[float, tuple[float, float]]],
    roles: Sequence[Role],
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Shares of the squared error of the rig as described, with their 90 % intervals.

    Args:
        shares: By name: the share of 1, and its interval.
        roles: Of each.
        ax: Axes to draw into; a new figure by default.
        title: Rig.
    """
    ax = style.axes(ax, 6.4, 1.7 + 0.3 * len(shares))
    for row, ((value, (low, high)), role) in enumerate(zip(shares.values(), roles, strict=True)):
        _bar(ax, row, 100.0 * value, role)
        ax.plot([100.0 * low, 100.0 * high], [row, row], color=style.BLACK, lw=1.0)
        end = 100.0 * max(value, high, 0.0)
        ax.annotate(
            f"  {100.0 * value:.0f} %".replace("-", "−"), (end, row), va="center", ha="left", fontsize=8
        )
    ax.set_yticks(range(len(shares)), [plain(name) for name in shares])
    ax.invert_yaxis()
    most = max(100.0, *(100.0 * high for _, (_, high) in shares.values()))
    ax.set_xlim(min(0.0, *(100.0 * low for _, (low, _) in shares.values())), 1.15 * most)
    ax.axvline(0.0, color=style.BLACK, lw=0.6)
    ax.set_xlabel("share of the squared error beyond the noise, unseen readings (%)")
    ax.set_title(plain(title))
    _legend(ax, [role for role in roles if role is not Role.OTHER])
    return ax


def _bar(ax: Axes, row: float, length: float, role: Role) -> None:
    ax.barh(row, length, color=COLOUR[role], hatch=HATCH.get(role), edgecolor="white", lw=0.0, height=0.7)


def _legend(ax: Axes, roles: Sequence[Role]) -> None:
    """Below the axes: each role that is drawn, and what else has a label."""
    handles: list[Artist] = [
        Patch(facecolor=COLOUR[role], hatch=HATCH.get(role), edgecolor="white", lw=0.0, label=str(role))
        for role in Role
        if role in roles
    ]
    others, _ = ax.get_legend_handles_labels()
    ax.figure.legend(handles=[*handles, *others], loc="outside lower center", ncols=2, fontsize=8)


@style.styled
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
    ax = style.axes(ax, 5.6, 4.4)
    divisor, band, unit = style.sigma_unit(sigma_T)
    across, up = explained_T / divisor, residual_T / divisor
    low, high = float(np.nanmin(across)), float(np.nanmax(across))
    line = np.array([low, high])
    ax.fill_between(line, line - band, line + band, color=style.NOISE, lw=0, label="± 1 sigma of the noise")
    ax.plot(line, line, color=style.BLACK, lw=0.9, label="fully explained")
    ax.axhline(0.0, color=style.GREY, lw=0.8, ls=":", label="not explained")
    for i, name in enumerate(style.COMPONENT):
        if np.isfinite(up[:, i]).any():
            ax.plot(
                across[:, i],
                up[:, i],
                ls="",
                marker=style.COMPONENT_MARKER[name],
                ms=3,
                alpha=0.45,
                mew=0,
                color=style.COMPONENT[name],
                label=f"B{name}",
            )
    centre, mean, error = _binned(across.ravel(), up.ravel())
    ax.errorbar(
        centre,
        mean,
        yerr=error,
        color=style.BLACK,
        marker="D",
        ms=4,
        lw=0,
        elinewidth=1.2,
        label="mean ± standard error",
    )
    largest = np.nanquantile(np.abs(up), 0.995)
    ax.set(ylim=(-1.1 * largest, 1.1 * largest))
    ax.set_xlabel(f"change in prediction by what was added ({unit})")
    ax.set_ylabel(f"residual without them ({unit})")
    ax.set_title(plain(title))
    ax.legend(fontsize=8, loc="upper left", ncols=2)
    return ax


@style.styled
def structure_bars(
    names: Sequence[str],
    before: Sequence[float],
    after: Sequence[float],
    title: str = "",
    floor: float = LEAST_P,
) -> Figure:
    """Significance of the residual's structure along each covariate, before and after causes were added.

    Args:
        names: Names of the covariates.
        before, after: p-value of each, corrected for testing all of them.
        title: Rig and date.
        floor: Smallest p-value that the test can tell; at it there is no length to draw, so an arrow says that it is smaller.
    """
    fig = style.figure(6.8, 1.8 + 0.3 * len(names), title)
    ax = fig.add_subplot()
    row = np.arange(len(names))
    for shift, values, colour, label in (
        (-0.2, before, style.ORANGE, "before"),
        (0.2, after, style.BLUE, "after"),
    ):
        p_values = np.asarray(values, dtype=float)
        is_least = p_values <= floor * (1.0 + ROUNDING)
        ax.barh(
            row + shift,
            np.where(is_least, 0.0, -np.log10(np.maximum(p_values, floor))),
            height=0.38,
            color=colour,
            label=label,
        )
        if is_least.any():
            told = f"{label}: p ≤ {floor:.1g}, the least that the test can tell"
            at = np.full(is_least.sum(), -np.log10(floor))
            ax.plot(at, (row + shift)[is_least], ">", color=colour, ms=7, label=told)
    ax.axvspan(
        0.0, -np.log10(0.05), color=style.PALE, zorder=0, lw=0, label="consistent with noise (p > 0.05)"
    )
    ax.set_yticks(row, [plain(name) for name in names])
    ax.invert_yaxis()
    ticks = np.arange(0, 5)
    ax.set_xticks(ticks, ["1", "0.1", "0.01", "0.001", "0.0001"])
    ax.set_xlabel("p-value, corrected for testing all covariates (smaller to the right)")
    fig.legend(fontsize=8, loc="outside lower center", ncols=2)  # no corner of the panel is free for certain
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

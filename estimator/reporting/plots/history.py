"""Parameters over time: what every session says by itself, the version in use, and how each session was concluded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import matplotlib.dates as mdates
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from estimator.reporting.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INSIDE_95,
    ORANGE,
    POSTERIOR,
    VERMILLION,
    Shown,
    figure,
    plain,
    shown,
    styled,
)
from estimator.units import split_unit

CONCLUSIONS = {
    "unchanged": (GREEN, "o"),
    "updated": (BLUE, "s"),
    "drifted": (VERMILLION, "D"),
    "rejected": (ORANGE, "X"),
}
HALF_WIDTH_90 = 1.644854


@dataclass(frozen=True)
class Visit:
    """One session.

    Attributes:
        taken: When.
        conclusion: What became of it.
        label: Written above it, such as the cause of a drift.
        estimate: Value and standard deviation of every parameter from it alone, by name, SI.
    """

    taken: datetime
    conclusion: str
    label: str
    estimate: Mapping[str, Sequence[float]]


@dataclass(frozen=True)
class InUse:
    """A version from one time to another, with the lower end, median and upper end of its 90 % intervals by name, SI."""

    begin: datetime
    end: datetime
    version: int
    intervals: Mapping[str, tuple[float, float, float]]


@styled
def history(visits: Sequence[Visit], in_use: Sequence[InUse], title: str = "") -> Figure:
    """Conclusions on top; below, one panel per parameter with the versions as bands and the sessions as points.

    Args:
        visits: In the order of time.
        in_use: Versions in the order of their use; one that was made current again comes again.
        title: Rig and dates.
    """
    names = list(dict.fromkeys(name for part in in_use for name in part.intervals))
    made = figure(9.0, 2.0 + 1.15 * len(names), title)
    strip, *panels = made.subplots(
        len(names) + 1, 1, sharex=True, squeeze=False, height_ratios=[1.1, *[1.0] * len(names)]
    ).flat
    _conclusions(strip, visits, in_use)
    for ax, name in zip(panels, names, strict=True):
        _parameter(ax, name, _shown(name, names), visits, in_use)
    bottom = panels[-1] if panels else strip
    locator = mdates.AutoDateLocator(minticks=3, maxticks=9)
    bottom.xaxis.set_major_locator(locator)
    bottom.xaxis.set_major_formatter(mdates.ConciseDateFormatter(locator))
    bottom.set_xlabel("time of the readings (UTC)")
    made.align_ylabels()
    return made


def _conclusions(ax: Axes, visits: Sequence[Visit], in_use: Sequence[InUse]) -> None:
    for visit in visits:
        colour, marker = CONCLUSIONS[visit.conclusion]
        ax.plot([_number(visit.taken)], [0.0], marker, color=colour, ms=7, clip_on=False)
        if visit.label:
            ax.annotate(
                plain(visit.label),
                (_number(visit.taken), 0.0),
                (0, 8),
                textcoords="offset points",
                ha="center",
                fontsize=8,
                color=colour,
            )
    for i, part in enumerate(in_use):
        if i:
            ax.axvline(_number(part.begin), color=POSTERIOR, lw=0.8, ls=":")
        ax.annotate(
            f"version {part.version}",
            (_number(part.begin), -1.0),
            (3, 0),
            textcoords="offset points",
            fontsize=8,
            color=POSTERIOR,
        )
    ax.set_ylim(-1.2, 1.2)
    ax.set_yticks([0.0], ["sessions"])
    ax.tick_params(axis="y", length=0, labelsize=8)
    ax.spines["left"].set_visible(False)
    found = [c for c in CONCLUSIONS if any(visit.conclusion == c for visit in visits)]
    handles = [
        Line2D([], [], ls="none", marker=CONCLUSIONS[c][1], color=CONCLUSIONS[c][0], label=c) for c in found
    ]
    handles += [
        Line2D([], [], marker="o", ms=3, color=GREY, label="one session, 90 %"),
        Patch(facecolor=INSIDE_95, edgecolor=POSTERIOR, label="version in use, 90 %"),  # type: ignore[list-item]
    ]
    ax.legend(handles=handles, ncols=len(handles), loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)


def _parameter(ax: Axes, name: str, show: Shown, visits: Sequence[Visit], in_use: Sequence[InUse]) -> None:
    for part in in_use:
        if name in part.intervals:
            lower, median, upper = (show.factor * value for value in part.intervals[name])
            span = [_number(part.begin), _number(part.end)]
            ax.fill_between(span, lower, upper, color=INSIDE_95, lw=0)
            ax.plot(span, [median, median], color=POSTERIOR, lw=1.2)
            ax.axvline(span[0], color=POSTERIOR, lw=0.8, ls=":")
    told = [visit for visit in visits if name in visit.estimate]
    for visit in told:
        value, sd = (show.factor * number for number in visit.estimate[name])
        colour = CONCLUSIONS[visit.conclusion][0]
        ax.errorbar(
            [_number(visit.taken)],
            [value],
            HALF_WIDTH_90 * sd,
            fmt="o",
            ms=3,
            color=colour,
            ecolor=GREY,
            elinewidth=1.0,
        )
    ax.set_ylabel(show.label, fontsize=8, rotation=0, ha="right", va="center")
    ax.tick_params(labelsize=8)


def _shown(name: str, names: Sequence[str]) -> Shown:
    """As in other pictures, but a quantity of a cause goes with its cause."""
    show = shown(names)[name]
    cause, _, key = name.rpartition(".")
    if "[" not in cause:
        return show
    words = f"{cause.partition('[')[0]} {split_unit(key)[0]}".replace("_", " ")
    return replace(show, words=words)


def _number(time: datetime) -> float:
    return float(mdates.date2num(time))

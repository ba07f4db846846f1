"""Parameters over time: the estimate of each session, the version in use, and the conclusion on each session."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import matplotlib.dates as mdates
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from estimator.readings.metrics import HALF_WIDTH_90
from estimator.reporting.numbers import Display, displays, plain
from estimator.reporting.plots import style
from estimator.units import split_quotient

CONCLUSIONS = {
    "unchanged": (style.GREEN, "o"),
    "updated": (style.BLUE, "s"),
    "drifted": (style.VERMILLION, "D"),
    "rejected": (style.ORANGE, "X"),
}

LABEL_WIDTH_PT = 4.6  # of a character of a label
STRIP_WIDTH_PT = 500.0  # of the axis of time
LABELS_Y, VERSIONS_Y = (0.25, 0.55, 0.85), (-1.0, -0.7)  # lines in which labels stand, in units of the strip


@dataclass(frozen=True)
class SessionSummary:
    """A session as the history shows it.

    Attributes:
        taken: Time of its readings.
        conclusion: One of `CONCLUSIONS`.
        label: Text above its mark, such as the cause of a drift.
        estimate: Value and standard deviation of every parameter from this session alone, by name, SI.
    """

    taken: datetime
    conclusion: str
    label: str
    estimate: Mapping[str, Sequence[float]]


@dataclass(frozen=True)
class VersionInUse:
    """A version with the period of its use, and by parameter the lower end, median and upper end of the 90 % interval, SI."""

    begin: datetime
    end: datetime
    version: int
    intervals: Mapping[str, tuple[float, float, float]]


@style.styled
def history(sessions: Sequence[SessionSummary], versions: Sequence[VersionInUse], title: str = "") -> Figure:
    """Conclusions on top; below, one panel per parameter with the versions as bands and the sessions as points.

    Args:
        sessions: Sessions in order of time.
        versions: Versions in order of use; one that was made current again appears again.
        title: Rig and dates.
    """
    # A cause that a session has drifted by is drawn, whether or not a version has it yet.
    of_causes = (name for session in sessions for name in session.estimate if "[" in name)
    of_versions = (name for version in versions for name in version.intervals)
    parameters = dict.fromkeys([*of_versions, *of_causes])
    names = sorted(parameters, key=lambda name: "[" not in name)  # what drifted stands on top
    fig = style.figure(9.0, 2.0 + 1.15 * len(names), title)
    strip, *panels = fig.subplots(
        len(names) + 1, 1, sharex=True, squeeze=False, height_ratios=[1.1, *[1.0] * len(names)]
    ).flat
    _conclusions(strip, sessions, versions)
    for ax, name in zip(panels, names, strict=True):
        _parameter(ax, name, _display(name, names), sessions, versions)
    bottom = panels[-1] if panels else strip
    locator = mdates.AutoDateLocator(minticks=3, maxticks=9)
    bottom.xaxis.set_major_locator(locator)
    bottom.xaxis.set_major_formatter(mdates.ConciseDateFormatter(locator))
    bottom.set_xlabel("time of the readings (UTC)")
    fig.align_ylabels()
    return fig


def _conclusions(ax: Axes, sessions: Sequence[SessionSummary], versions: Sequence[VersionInUse]) -> None:
    times = [_number(s.taken) for s in sessions] + [
        _number(end) for v in versions for end in (v.begin, v.end)
    ]
    days_per_pt = max(max(times, default=0.0) - min(times, default=0.0), 1e-9) / STRIP_WIDTH_PT
    lines = _lines([(_number(s.taken), plain(s.label)) for s in sessions], days_per_pt, len(LABELS_Y))
    for session, line in zip(sessions, lines, strict=True):
        colour, marker = CONCLUSIONS[session.conclusion]
        taken = _number(session.taken)
        ax.plot([taken], [0.0], marker, color=colour, ms=7, clip_on=False)
        if line is not None:
            words = plain(session.label)
            ax.text(taken, LABELS_Y[line], words, ha="center", fontsize=8, color=colour)
    names = [f" version {version.version}" for version in versions]
    begins = [_number(version.begin) for version in versions]
    # `_lines` takes the middle of a label; these begin where the version does.
    middles = [
        begin + 0.5 * LABEL_WIDTH_PT * len(name) * days_per_pt
        for begin, name in zip(begins, names, strict=True)
    ]
    lines = _lines(list(zip(middles, names, strict=True)), days_per_pt, len(VERSIONS_Y))
    for i, (begin, name, line) in enumerate(zip(begins, names, lines, strict=True)):
        if i:
            ax.axvline(begin, color=style.POSTERIOR, lw=0.8, ls=":")
        if line is not None:
            ax.text(begin, VERSIONS_Y[line], name, fontsize=8, color=style.POSTERIOR)
    ax.set_ylim(-1.2, 1.2)
    ax.set_yticks([0.0], ["sessions"])
    ax.tick_params(axis="y", length=0, labelsize=8)
    ax.spines["left"].set_visible(False)
    present = {session.conclusion for session in sessions}
    handles = [
        Line2D([], [], ls="none", marker=marker, color=colour, label=conclusion)
        for conclusion, (colour, marker) in CONCLUSIONS.items()
        if conclusion in present
    ]
    handles += [
        Line2D([], [], marker="o", ms=3, color=style.GREY, label="single session, 90 %"),
        Patch(facecolor=style.INSIDE_95, edgecolor=style.POSTERIOR, label="version in use, 90 %"),  # type: ignore[list-item]
    ]
    ax.legend(handles=handles, ncols=len(handles), loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)


def _lines(labels: Sequence[tuple[float, str]], days_per_pt: float, n_lines: int) -> list[int | None]:
    """Line for each label, so that none lies on another; None where all lines are taken, or there is no label.

    Args:
        labels: Time of the middle, and text.
        days_per_pt: Scale of the axis.
        n_lines: Lines that there are.

    Examples:
        >>> _lines([(0.0, "axis gain"), (1.0, "axis gain"), (2.0, ""), (3.0, "drift"), (90.0, "drift")], 1.0, 2)
        [0, 1, None, None, 0]
    """
    ends = [-math.inf] * n_lines
    lines: list[int | None] = []
    for middle, text in labels:
        half_width = 0.5 * LABEL_WIDTH_PT * (len(text) + 1) * days_per_pt
        free = [i for i, end in enumerate(ends) if end < middle - half_width]
        lines.append(free[0] if free and text else None)
        if free and text:
            ends[free[0]] = middle + half_width
    return lines


def _parameter(
    ax: Axes,
    name: str,
    display: Display,
    sessions: Sequence[SessionSummary],
    versions: Sequence[VersionInUse],
) -> None:
    for version in versions:
        if name in version.intervals:
            lower, median, upper = (display.factor * value for value in version.intervals[name])
            span = [_number(version.begin), _number(version.end)]
            ax.fill_between(span, lower, upper, color=style.INSIDE_95, lw=0)
            ax.plot(span, [median, median], color=style.POSTERIOR, lw=1.2)
            ax.axvline(span[0], color=style.POSTERIOR, lw=0.8, ls=":")
    for session in sessions:
        if name not in session.estimate:
            continue
        value, sd = (display.factor * number for number in session.estimate[name])
        colour = CONCLUSIONS[session.conclusion][0]
        ax.errorbar(
            [_number(session.taken)],
            [value],
            HALF_WIDTH_90 * sd,
            fmt="o",
            ms=3,
            color=colour,
            ecolor=style.GREY,
            elinewidth=1.0,
        )
    ax.set_ylabel(display.label, fontsize=8, rotation=0, ha="right", va="center")
    ax.tick_params(labelsize=8)


def _display(name: str, names: Sequence[str]) -> Display:
    """How a parameter is shown: as in other plots, but with the name of the cause before its quantity."""
    display = displays(names)[name]
    cause, _, key = name.rpartition(".")
    if "[" not in cause:
        return display
    words = f"{cause.partition('[')[0]} {split_quotient(key)[0]}".replace("_", " ")
    return replace(display, words=words)


def _number(time: datetime) -> float:
    return float(mdates.date2num(time))

"""Results of sampling: traces of the walkers, and the posterior of every parameter beside its prior.

Values come by parameter name in SI units; `estimator.reporting.numbers.displays` shortens names and picks display
units.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Num
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from estimator.reporting.numbers import Display, displays, plain, summary
from estimator.reporting.plots import style
from estimator.rig.parameters import Prior

MOST_BLOCKS = 120  # what jumps from pixel to pixel fills half a page's bytes and shows nothing more
N_SINGLE_WALKERS = 2
PRIOR_DRAWS = 20_000
LEARNT_LITTLE = 1.5  # prior over posterior standard deviation


@style.styled
def traces(chains: Mapping[str, Num[np.ndarray, "step walker"]], title: str = "") -> Figure:
    """Median and 68 and 95 % bands over all walkers against the step, with two single walkers; parameters stand in two columns.

    Long chains are pooled in blocks of neighbouring steps.

    Args:
        chains: All walkers by the name of the parameter, SI.
        title: Rig and date.
    """
    n_rows = (len(chains) + 1) // 2
    fig = style.figure(10.0, 0.8 + 1.4 * n_rows, title)
    grid = fig.subplots(n_rows, 2, squeeze=False, sharex=True)
    for ax in grid.flat[len(chains) :]:
        ax.set_axis_off()
    for ax, (name, display) in zip(grid.flat, displays(list(chains)).items(), strict=False):
        _trace(ax, chains[name], display)
    for ax in grid[-1]:
        ax.set_xlabel("step")
    return fig


@style.styled
def interval_summary(
    draws: Mapping[str, Num[np.ndarray, " draw"]],
    prior: Mapping[str, Prior],
    truth: Mapping[str, float] | None = None,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Prior and posterior of every parameter in prior standard deviations: the shorter the bar, the more the readings told.

    Args:
        draws: Posterior draws by parameter name, SI.
        prior: Priors by name; parameters without a prior are left out.
        truth: True values of a simulation.
        ax: Axes to draw into; a new figure by default.
        title: Rig and date.
    """
    names = {name: display for name, display in displays(list(draws)).items() if name in prior}
    ax = style.axes(ax, 7.5, 1.4 + 0.38 * len(names))
    for row, (name, display) in enumerate(names.items()):
        centre, sd = prior[name].centre, prior[name].sd
        values = np.asarray(draws[name], dtype=float)
        prior_values = prior[name].sample(np.random.default_rng(0), PRIOR_DRAWS)
        _bars(ax, row - 0.17, (prior_values - centre) / sd, (style.PALE, style.PRIOR))
        _bars(ax, row + 0.17, (values - centre) / sd, (style.INSIDE_95, style.INSIDE_68))
        ax.plot((np.median(values) - centre) / sd, row + 0.17, "|", color=style.POSTERIOR, ms=10, mew=2.2)
        if truth and name in truth:
            ax.plot((truth[name] - centre) / sd, row + 0.17, "x", color=style.TRUTH, ms=6, mew=1.6, zorder=3)
        text = f"{summary(values * display.factor, display)}\n{_learnt(sd, float(values.std()))}"
        ax.annotate(text, (1.01, row), xycoords=style.SIDE_AND_DATA, va="center", fontsize=8)
    ax.axvline(0.0, color=style.BLACK, lw=0.6)
    ax.set_yticks(range(len(names)), [display.words for display in names.values()])
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlabel("distance from the prior's centre (prior standard deviations)")
    ax.set_title(plain(title), pad=24)
    labels = ("prior 68 %", "prior 95 %", "posterior 68 %", "posterior 95 %")
    colours = (style.PRIOR, style.PALE, style.INSIDE_68, style.INSIDE_95)
    handles: list[Artist] = [Patch(color=c, label=label) for c, label in zip(colours, labels, strict=True)]
    if truth:
        handles.append(Line2D([], [], ls="none", marker="x", color=style.TRUTH, label="truth"))
    ax.legend(handles=handles, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
    return ax


def _trace(ax: Axes, chain: np.ndarray, display: Display) -> None:
    values = np.asarray(chain, dtype=float) * display.factor
    blocks = np.array_split(np.arange(len(values)), min(len(values), MOST_BLOCKS))
    step = [block.mean() for block in blocks]
    quantiles = np.array([np.quantile(values[block], style.QUANTILES_95_68_50) for block in blocks]).T
    ax.fill_between(step, quantiles[0], quantiles[4], color=style.INSIDE_95, lw=0)
    ax.fill_between(step, quantiles[1], quantiles[3], color=style.INSIDE_68, lw=0)
    first = [block[0] for block in blocks]
    for walker in np.linspace(0, values.shape[1] - 1, N_SINGLE_WALKERS).astype(int):
        ax.plot(first, values[first, walker], color=style.GREY, lw=0.4)
    ax.plot(step, quantiles[2], color=style.BLACK, lw=1.2)
    ax.set_xlim(0.0, max(1.0, len(values) - 1.0))
    ax.set_title(
        display.label, fontsize=8, loc="left", pad=3
    )  # beside a panel so low, names of causes would overlap


def _bars(ax: Axes, height: float, scaled: np.ndarray, colours: tuple[str, str]) -> None:
    low95, low68, _, high68, high95 = np.quantile(scaled, style.QUANTILES_95_68_50)
    ax.barh(height, high95 - low95, 0.3, left=low95, color=colours[0])
    ax.barh(height, high68 - low68, 0.3, left=low68, color=colours[1])


def _learnt(prior_sd: float, sd: float) -> str:
    if sd == 0.0:
        return "all draws agree"
    narrower = prior_sd / sd
    if narrower < LEARNT_LITTLE:
        return "little learnt"
    return f"{narrower:.0f} times narrower" if narrower >= 10.0 else f"{narrower:.1f} times narrower"

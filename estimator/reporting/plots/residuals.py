"""Residuals: by how much readings differ from predictions, and where.

A residual is measured minus predicted, in the sensor's frame; components that were not measured are NaN. Zero and
the band of one sigma are always drawn: two thirds of pure noise lie inside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from scipy.special import gammaincinv

from estimator.reporting.numbers import plain
from estimator.reporting.plots.style import (
    BLACK,
    COMPONENT,
    COMPONENT_MARKER,
    NOISE,
    QUANTILES_95_68_50,
    SIDE_AND_DATA,
    axes,
    sigma_unit,
    styled,
)

Components = Float[np.ndarray, "reading 3"]
READINGS_PER_BIN = 25
MOST_BINS = 16
FURTHEST_SIGMA = 8.0
# Size and opacity of points, by the largest number of readings that they suit.
LOOK_OF_POINTS = {500: (3.0, 0.7), 3000: (2.5, 0.5), np.inf: (1.5, 0.25)}


@styled
def predicted_against_measured(
    measured_T: Components,
    predicted_T: Components,
    sigma_T: float | Components,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Predicted against measured components in mT, with residuals below.

    Args:
        measured_T: Readings; NaN where a component was not measured.
        predicted_T: Predictions of the model.
        sigma_T: One standard deviation of the noise, common or of each component.
        ax: Axes for both panels; a new figure by default.
        title: Rig and date.
    Returns: The Axes; its `child_axes` are the upper and the lower panel.
    """
    ax = axes(ax, 5.6, 5.2)
    ax.set_axis_off()
    ax.set_title(plain(title))
    upper = ax.inset_axes((0.0, 0.36, 1.0, 0.64))
    lower = ax.inset_axes((0.0, 0.0, 1.0, 0.30), sharex=upper)
    for i, name in enumerate(COMPONENT):
        if np.isfinite(measured_T[:, i]).any():
            across, up = measured_T[:, i] * 1e3, predicted_T[:, i] * 1e3
            upper.plot(across, up, **_points(name, len(measured_T)), label=f"B{name}")
    low, high = float(np.nanmin(measured_T)) * 1e3, float(np.nanmax(measured_T)) * 1e3
    upper.plot([low, high], [low, high], color=BLACK, lw=0.8, zorder=1, label="equal")
    upper.set_ylabel("predicted (mT)")
    upper.tick_params(labelbottom=False)
    # Free above the line; to look for the best place takes seconds in a large session.
    legend = upper.legend(ncols=2, loc="upper left")
    for handle in filter(None, legend.legend_handles):
        handle.set(alpha=1.0, markersize=5.0)  # points of a large session are too faint to tell apart
    _draw_residuals(lower, measured_T * 1e3, measured_T - predicted_T, sigma_T)
    lower.set_xlabel("measured (mT)")
    return ax


@styled
def residual_against(
    covariate: Float[np.ndarray, " reading"],
    residual_T: Components,
    sigma_T: float | Components,
    label: str,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Residuals against time, current, distance or any other covariate; means of neighbours show what noise would hide.

    Args:
        covariate: Values in the unit that `label` names.
        residual_T: Measured minus predicted.
        sigma_T: One standard deviation of the noise.
        label: Label of the horizontal axis, with its unit.
        ax: Axes to draw into; a new figure by default.
        title: Rig and date.
    """
    ax = axes(ax)
    _draw_residuals(ax, np.repeat(covariate[:, None], 3, axis=1), residual_T, sigma_T)
    divisor, _, _ = sigma_unit(sigma_T)
    values = residual_T / divisor
    group = _neighbours(covariate)
    for i, name in enumerate(COMPONENT):
        centre, mean, error = _means(covariate, values[:, i], group)
        style: dict[str, Any] = {
            "color": COMPONENT[name],
            "marker": COMPONENT_MARKER[name],
            "ms": 5,
            "lw": 1.4,
        }
        ax.errorbar(centre, mean, yerr=error, label=f"B{name}", **style)
    ax.set_xlabel(plain(label))
    ax.set_title(plain(title), pad=34)
    text = "points: readings; lines: mean of neighbours ± standard error"
    ax.legend(
        ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), title=text, fontsize=8, title_fontsize=8
    )
    return ax


@styled
def residual_histogram(
    residual_T: Components, sigma_T: float | Components, ax: Axes | None = None, title: str = ""
) -> Axes:
    """Whitened residuals beside the standard normal density, which they follow if model and noise are right."""
    ax = axes(ax)
    whitened = residual_T / np.asarray(sigma_T)
    reach = max(4.0, float(np.nanmax(np.abs(whitened))))
    n_bins = int(np.clip(1.5 * np.sqrt(len(whitened)), 12, 48))
    bins = np.linspace(-min(reach, FURTHEST_SIGMA), min(reach, FURTHEST_SIGMA), n_bins + 1)
    ax.axvspan(-1.0, 1.0, color=NOISE, lw=0)
    ax.axvline(0.0, color=BLACK, lw=0.8)
    for i, name in enumerate(COMPONENT):
        values = whitened[:, i][np.isfinite(whitened[:, i])]
        if len(values):
            text = f"B{name}: mean {values.mean():+.2f}, sd {values.std():.2f}"
            clipped = np.clip(values, bins[0], bins[-1])
            ax.hist(
                clipped, list(bins), density=True, histtype="step", color=COMPONENT[name], lw=1.5, label=text
            )
    grid = np.linspace(bins[0], bins[-1], 200)
    ax.plot(
        grid,
        np.exp(-0.5 * grid**2) / math.sqrt(2.0 * math.pi),
        color=BLACK,
        ls="--",
        lw=1.2,
        label="unit normal",
    )
    ax.set_xlabel("residual / sigma")
    ax.set_ylabel("density per sigma")
    ax.set_title(plain(title))
    ax.legend(fontsize=8)
    return ax


@styled
def residual_by_sensor(
    residual_T: Components,
    sensor: Int[np.ndarray, " reading"],
    names: Sequence[str],
    sigma_T: float | Components,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Rms residual of every sensor and component relative to the sensor's noise, with the range expected from noise alone.

    Args:
        residual_T: Measured minus predicted.
        sensor: Index into `names`.
        names: Names of the sensors.
        sigma_T: One standard deviation of the noise.
        ax: Axes to draw into; a new figure by default.
        title: Rig and date.
    """
    ax = axes(ax, 5.6, 1.8 + 0.32 * len(names))
    sigma = np.broadcast_to(np.asarray(sigma_T), residual_T.shape)
    whitened = residual_T / sigma
    largest, labelled = 1.3, set()
    for row in range(len(names)):
        values = whitened[sensor == row]
        is_measured = np.isfinite(values)
        if not is_measured.any():
            continue
        n = int(is_measured.sum(axis=0).max())
        low95, low68, _, high68, high95 = np.sqrt(
            2.0 * gammaincinv(0.5 * n, QUANTILES_95_68_50) / n
        )  # chi-squared
        ax.barh(row, high95 - low95, left=low95, height=0.7, color=NOISE)
        ax.barh(row, high68 - low68, left=low68, height=0.7, color="#c4c4c4")
        rms = [_rms(values[:, i]) if is_measured[:, i].any() else np.nan for i in range(3)]
        for value, name in zip(rms, COMPONENT, strict=True):
            if np.isfinite(value):
                label = "" if name in labelled else f"B{name}"
                labelled.add(name)
                ax.plot(
                    value, row, COMPONENT_MARKER[name], color=COMPONENT[name], ms=6, zorder=3, label=label
                )
        noise_uT = _rms(sigma[sensor == row]) * 1e6
        text = f"{_rms(residual_T[sensor == row]) * 1e6:.3g} µT, noise {noise_uT:.3g} µT"
        end = float(np.nanmax([*rms, high95]))
        ax.annotate(text, (end, row), (8, 0), textcoords="offset points", va="center")
        largest = max(largest, end)
    ax.axvline(0.0, color=BLACK, lw=0.8)
    ax.axvline(1.0, color=BLACK, lw=0.8, ls="--")
    ax.set_xlim(0.0, 1.6 * largest)
    ax.set_yticks(range(len(names)), [plain(name) for name in names])
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlabel("rms residual / sigma (grey: 68 and 95 % ranges of noise alone)")
    ax.set_title(plain(title), pad=22)
    ax.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
    return ax


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _draw_residuals(
    ax: Axes, across: np.ndarray, residual_T: Components, sigma_T: float | Components
) -> None:
    divisor, band, unit = sigma_unit(sigma_T)
    ax.axhspan(-band, band, color=NOISE, lw=0)
    ax.axhline(0.0, color=BLACK, lw=0.8)
    for i, name in enumerate(COMPONENT):
        ax.plot(across[:, i], (residual_T / divisor)[:, i], **_points(name, len(residual_T)))
    ax.set_ylabel(f"residual ({unit})")
    ax.annotate("± 1 sigma", (1.0, band), xycoords=SIDE_AND_DATA, ha="left", va="center", fontsize=8)


def _points(name: str, n: int) -> dict[str, Any]:
    size, alpha = next(look for most, look in LOOK_OF_POINTS.items() if n <= most)
    return {
        "color": COMPONENT[name],
        "marker": COMPONENT_MARKER[name],
        "ms": size,
        "alpha": alpha,
        "ls": "none",
        "mew": 0,
    }


def _neighbours(covariate: np.ndarray) -> np.ndarray:
    """Group of every reading: equal values if there are few distinct ones, otherwise neighbours in groups of equal size."""
    distinct = np.unique(covariate)
    if len(distinct) <= MOST_BINS:
        return np.asarray(np.searchsorted(distinct, covariate))
    n_bins = int(np.clip(len(covariate) // READINGS_PER_BIN, 2, MOST_BINS))
    edges = np.unique(np.quantile(covariate, np.linspace(0.0, 1.0, n_bins + 1)[1:-1]))
    return np.asarray(np.digitize(covariate, edges))


def _means(
    covariate: np.ndarray, values: np.ndarray, group: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre, mean and standard error of every group of at least two values."""
    is_measured = np.isfinite(values)
    rows = []
    for i in np.unique(group[is_measured]):
        in_group = is_measured & (group == i)
        if in_group.sum() > 1:
            standard_error = values[in_group].std(ddof=1) / np.sqrt(in_group.sum())
            rows.append((covariate[in_group].mean(), values[in_group].mean(), standard_error))
    table = np.array(rows).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]

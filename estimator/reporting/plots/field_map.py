"""Calibrated field of one coil in a plane through its axis, and its relative uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Rectangle
from matplotlib.ticker import LogLocator, MaxNLocator

from estimator.field.winding import Winding
from estimator.reporting.plots.style import BLACK, ERROR_MAP, FIELD_MAP, WINDING, WINDING_EDGE, figure, styled


@styled
def field_plane(
    x_m: Float[np.ndarray, " x"],
    z_m: Float[np.ndarray, " z"],
    field_T_per_A: Float[np.ndarray, "z x 3"],
    relative_half_width: Float[np.ndarray, "z x"],
    winding: Winding | None,
    readings_m: Float[np.ndarray, "reading 3"] | None = None,
    title: str = "",
) -> Figure:
    """Calibrated field in the plane y = 0 of the coil frame, and its relative uncertainty.

    Args:
        x_m: Coordinates across the axis, evenly spaced, increasing.
        z_m: Coordinates along the axis, evenly spaced, increasing.
        field_T_per_A: Field of one ampere in the coil frame; values inside the winding are hidden.
        relative_half_width: Half-width of the 90 % credible interval of |B|, relative to |B|.
        winding: Winding of the coil (no batch); None where it is not known.
        readings_m: Sensor positions in the coil frame; beyond them the model extrapolates.
        title: Rig and date.
    """
    x_mm, z_mm = x_m * 1e3, z_m * 1e3
    fig, (left, right) = _two_planes(x_mm, z_mm, winding, title)
    size_mT = np.linalg.norm(field_T_per_A, axis=-1) * 1e3
    is_known = np.isfinite(size_mT)  # another coil's winding may reach into the plane
    if winding is not None:
        across_m = np.abs(x_m)[None, :]
        inner_m = float(winding.radius_m - winding.thickness_m)
        is_beside = (z_m > 0.0) | (z_m < -float(winding.length_m))
        is_known &= (across_m < inner_m) | (across_m > float(winding.radius_m)) | is_beside[:, None]
    low, high = np.quantile(size_mT[is_known], (0.01, 0.995))
    levels = np.geomspace(low, high, 13)
    filled = left.contourf(
        x_mm, z_mm, np.ma.masked_invalid(size_mT), levels, norm=LogNorm(), cmap=FIELD_MAP, extend="both"
    )
    across, along = field_T_per_A[..., 0], field_T_per_A[..., 2]
    left.streamplot(x_mm, z_mm, across, along, color="white", linewidth=0.6, arrowsize=0.7, density=0.9)
    ticks = LogLocator(subs=(1.0, 2.0, 5.0))
    bar = fig.colorbar(filled, ax=left, label="|B| (mT/A)", ticks=ticks, format="%g")
    bar.ax.minorticks_off()
    left.set_title("field and field lines, y = 0")
    percent = 100.0 * relative_half_width
    top = float(np.quantile(percent[is_known], 0.98))
    steps = MaxNLocator(10).tick_values(0.0, top or 1.0)
    filled = right.contourf(
        x_mm, z_mm, np.ma.masked_invalid(percent), list(steps), cmap=ERROR_MAP, extend="max"
    )
    fig.colorbar(filled, ax=right, label="half-width of the 90 % credible interval of |B| (%)")
    right.set_title("relative uncertainty of |B|")
    if readings_m is not None:
        positions_mm = np.unique(np.round(readings_m[:, [0, 2]], 3), axis=0) * 1e3
        label = "sensor positions, all y"
        right.plot(*positions_mm.T, "o", color="white", mec=BLACK, mew=0.5, ms=3, label=label, zorder=4)
        right.legend(loc="upper right", frameon=True, framealpha=1.0, fontsize=8)
    return fig


def draw_winding(ax: Axes, winding: Winding, up: str, zorder: float = 0.5) -> None:
    """Draw the winding's section in XZ (two rectangles) or its outline in XY (a ring), in mm."""
    sizes_m = (winding.radius_m, winding.thickness_m, winding.length_m)
    radius, thickness, length = (1e3 * float(size_m) for size_m in sizes_m)
    style: dict[str, Any] = {"facecolor": WINDING, "edgecolor": WINDING_EDGE, "lw": 0.8, "zorder": zorder}
    if up == "y":
        ax.add_patch(Annulus((0.0, 0.0), radius, min(thickness, 0.999 * radius), **style))
    else:
        ax.add_patch(Rectangle((radius - thickness, -length), thickness, length, **style))
        ax.add_patch(Rectangle((-radius, -length), thickness, length, **style))


MOST_SDS = 10.0  # shown; beyond it the colour is that of more


@styled
def difference_plane(
    x_m: Float[np.ndarray, " x"],
    z_m: Float[np.ndarray, " z"],
    difference_T_per_A: Float[np.ndarray, "z x"],
    sds: Float[np.ndarray, "z x"],
    winding: Winding | None,
    title: str = "",
) -> Figure:
    """Length of the difference of two fields in the plane y = 0 of a coil, and the same in standard deviations.

    Args:
        x_m: Coordinates across the axis, evenly spaced, increasing.
        z_m: Coordinates along the axis, evenly spaced, increasing.
        difference_T_per_A: Length of the difference for one ampere; NaN inside a winding.
        sds: The same over the standard deviation of that difference.
        winding: Winding of the coil (no batch); None where it is not known.
        title: Rig and date.
    """
    x_mm, z_mm = x_m * 1e3, z_m * 1e3
    fig, panels = _two_planes(x_mm, z_mm, winding, title)
    size_uT = 1e6 * difference_T_per_A
    top_uT = float(np.nanquantile(size_uT, 0.98)) or 1.0
    most_sds = min(MOST_SDS, max(2.0, float(np.nanmax(sds, initial=0.0))))
    for ax, values, top, label, heading in (
        (panels[0], size_uT, top_uT, "|ΔB| (µT/A)", "difference of the fields, y = 0"),
        (panels[1], sds, most_sds, "|ΔB| / standard deviation", "in standard deviations of both together"),
    ):
        levels = np.linspace(0.0, top, 11)
        filled = ax.contourf(x_mm, z_mm, np.ma.masked_invalid(values), levels, cmap=ERROR_MAP, extend="max")
        fig.colorbar(filled, ax=ax, label=label, format="%.3g")
        ax.set_title(heading)
    return fig


def _two_planes(
    x_mm: np.ndarray, z_mm: np.ndarray, winding: Winding | None, title: str
) -> tuple[Figure, list[Axes]]:
    """Two panels of the plane side by side, with the winding in each."""
    fig = figure(10.0, 0.9 + 3.7 * float(np.clip(np.ptp(z_mm) / np.ptp(x_mm), 0.4, 2.0)), title)
    panels: list[Axes] = list(fig.subplots(1, 2, sharex=True, sharey=True))
    for ax in panels:
        if winding is not None:
            draw_winding(ax, winding, "z", zorder=3.0)
        ax.set_facecolor(WINDING)  # visible where the model has no value: inside a winding
        ax.set(xlim=x_mm[[0, -1]], ylim=z_mm[[0, -1]], aspect="equal", xlabel="x (mm)")
    panels[0].set_ylabel("z (mm)")
    return fig, panels

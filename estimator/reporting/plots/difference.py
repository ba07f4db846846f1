"""Difference of two fields in a plane, and how it compares with what is known of both."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from estimator.field.winding import Winding
from estimator.reporting.plots.field_map import draw_winding
from estimator.reporting.plots.style import ERROR_MAP, WINDING, figure, styled

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
    fig = figure(10.0, 0.9 + 3.7 * float(np.clip(np.ptp(z_mm) / np.ptp(x_mm), 0.4, 2.0)), title)
    panels = fig.subplots(1, 2, sharex=True, sharey=True)
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
        if winding is not None:
            draw_winding(ax, winding, "z", zorder=3.0)
        ax.set_facecolor(WINDING)
        ax.set(xlim=x_mm[[0, -1]], ylim=z_mm[[0, -1]], aspect="equal", xlabel="x (mm)", title=heading)
    panels[0].set_ylabel("z (mm)")
    return fig

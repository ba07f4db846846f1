"""Shared by all plots: colours by meaning, the unit of residuals, and figures that need no screen.

The colours are those of Okabe and Ito, distinct for every kind of colour vision; components differ by marker as well.
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.reporting.numbers import plain
from estimator.units import UNITS

BLACK, GREY, PALE = "#000000", "#7f7f7f", "#e3e3e3"
BLUE, ORANGE, GREEN, VERMILLION, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"

COMPONENT = {"x": VERMILLION, "y": GREEN, "z": BLUE}
COMPONENT_MARKER = {"x": "o", "y": "s", "z": "^"}
POSTERIOR = BLUE
INSIDE_68, INSIDE_95, OUTSIDE = "#4c93c3", "#a6cae1", "#e3eef6"
PRIOR = "#bdbdbd"
TRUTH = VERMILLION
POINT = BLACK
NOISE = "#e6e6e6"
WINDING, WINDING_EDGE = "#b3b3b3", "#595959"
FIELD_MAP, ERROR_MAP = "viridis", "YlOrRd"

QUANTILES_95_68_50 = (0.025, 0.16, 0.5, 0.84, 0.975)

RC: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "figure.titlesize": 11.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "legend.frameon": False,
    "figure.facecolor": "white",
}
SIDE_AND_DATA = ("axes fraction", "data")

styled = mpl.rc_context(RC)
"""Decorator under which a plot function draws."""


def axes(ax: Axes | None, width_in: float = 5.6, height_in: float = 3.6) -> Axes:
    """The given Axes, or those of a new figure."""
    return ax if ax is not None else figure(width_in, height_in).add_subplot()


def figure(width_in: float, height_in: float, title: str = "") -> Figure:
    """An empty figure outside pyplot, which needs neither closing nor a screen."""
    fig = Figure(figsize=(width_in, height_in), layout="constrained")
    if title:
        fig.suptitle(plain(title))
    return fig


def sigma_unit(
    sigma_T: float | Float[np.ndarray, "reading 3"],
) -> tuple[Float[np.ndarray, "..."], float, str]:
    """Divisor, half-width of the noise band and unit for residuals.

    The unit is µT if the noise is one number. If it differs between readings, only multiples of sigma compare.

    Examples:
        >>> divisor, band, unit = sigma_unit(20e-6)
        >>> round(float(divisor), 9), round(band, 6), unit
        (1e-06, 20.0, 'µT')
    """
    sigma = np.asarray(sigma_T, dtype=float)
    if np.ptp(sigma) <= 1e-6 * np.max(sigma):
        return np.asarray(UNITS["uT"].to_si), float(np.max(sigma)) / UNITS["uT"].to_si, "µT"
    return sigma, 1.0, "sigma"

"""Amplitudes of a coil without a winding by degree: how fast its harmonics fall, and up to where readings tell of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from estimator.reporting.numbers import plain
from estimator.reporting.plots.style import INSIDE_95, POSTERIOR, PRIOR, axes, styled

SPREAD = 0.5  # of the distance between degrees, over which the amplitudes of one stand side by side
LOWEST = 0.05  # of the smallest sd: smaller amplitudes are zero as far as anyone can tell
TO_MICROTESLA = 1e6


@styled
def harmonic_spectrum(
    medians_T_per_A: Mapping[int, Float[np.ndarray, " term"]],
    sds_T_per_A: Mapping[int, Float[np.ndarray, " term"]],
    prior_sd_T_per_A: Mapping[int, float],
    ax: Axes | None = None,
    *,
    title: str = "",
) -> Axes:
    """Size of every amplitude over its degree, beside the posterior's and the prior's standard deviation.

    Where points sink into the band, readings no longer tell of that degree. Where they still lie far above it at the highest, a higher one
    is missing.

    Args:
        medians_T_per_A, sds_T_per_A: Of the amplitudes, by degree.
        prior_sd_T_per_A: By degree.
        ax: Where to draw; a new figure by default.
        title: Shown above.
    """
    ax = axes(ax, 6.2, 3.6)
    degrees = list(medians_T_per_A)
    band = np.array([np.sqrt(np.mean(sds_T_per_A[degree] ** 2)) for degree in degrees]) * TO_MICROTESLA
    edges = np.append(np.array(degrees) - 0.5, degrees[-1] + 0.5)
    ax.stairs(band, edges, baseline=0.0, fill=True, color=INSIDE_95, label="posterior sd (rms of a degree)")
    prior = [prior_sd_T_per_A[degree] * TO_MICROTESLA for degree in degrees]
    ax.plot(degrees, prior, color=PRIOR, lw=2.0, label="prior sd")
    for degree in degrees:
        size = np.abs(medians_T_per_A[degree]) * TO_MICROTESLA
        across = degree + SPREAD * (np.linspace(-0.5, 0.5, len(size)))
        label = "amplitudes, one point each" if degree == degrees[0] else None
        ax.plot(across, size, ".", color=POSTERIOR, ms=4.0, label=label)
    ax.set_yscale("log")
    ax.set_ylim(bottom=LOWEST * band.min())
    ax.set_xticks(degrees)
    ax.set(xlabel="degree", ylabel="|amplitude| (µT/A)", title=plain(title))
    ax.legend(fontsize=8.0)
    return ax

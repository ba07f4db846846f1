"""Twins of `residual_causes.py` beside the numbers of Tables 8 to 10, as a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from estimator.reporting.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILLION,
    figure,
    styled,
)
from scripts.paper import printed
from scripts.paper.residual_causes import Twin

# The first words of a cause decide; what is not listed is grey.
LOOKS = {
    "eq 13 and": (ORANGE, "D", "eq 13 and wrong axes"),
    "eq 13": (PURPLE, "s", "eq 13 as printed"),
    "axes": (VERMILLION, "^", "wrong axes of sensor or displacement"),
    "field of the room": (BLUE, "v", "field of the room"),
    "iron table": (GREEN, "P", "iron table"),
    "": (GREY, "o", "start, arm or current off"),
}


@styled
def drawn(twins: Sequence[Twin], ratio: float, relative: float, relative_to_rms: float) -> Figure:
    """Residuals by both readings of Table 10, and the winding that was found; black is the paper.

    Args:
        twins: Of all causes.
        ratio: Printed RMSE after over before.
        relative: Printed RMSE after over its divisor.
        relative_to_rms: The same over the rms field, if the divisor is the norm of all readings.
    """
    fig = figure(11.0, 4.2, "What each mistake leaves, one mark a simulated experiment; black: the paper")
    largest, norm, winding = fig.subplots(1, 3)
    for first_words, (colour, marker, words) in LOOKS.items():
        some = [t for t in twins if next(w for w in LOOKS if t.cause.startswith(w)) == first_words]
        after_T = np.array([t.rms_T[1] for t in some])
        look = {"color": colour, "marker": marker, "ls": "", "ms": 4, "alpha": 0.7, "label": words}
        reduced = after_T / [t.rms_T[0] for t in some]
        largest.plot(reduced, after_T / [t.field_max_T for t in some], **look)
        norm.plot(reduced, after_T / [t.field_rms_T for t in some], **look)
        radius_mm, wire_mm = np.array([t.numbers[:2] for t in some]).T
        winding.plot(radius_mm, np.clip(wire_mm, 0.01, 1.0), **look)
    paper = {"color": BLACK, "marker": "*", "ms": 13, "ls": "", "label": "the paper"}
    largest.plot(ratio, relative, **paper)
    norm.plot(ratio, relative_to_rms, **paper)
    winding.plot(*printed.CALIBRATED[:2], **paper)
    winding.plot(*printed.MEASURED[:2], color=BLACK, marker="+", ms=11, ls="", label="measured by the paper")
    largest.set(ylabel="rms error after / largest field")
    norm.set(ylabel="rms error after / rms field")
    for ax in (largest, norm):
        ax.set(xlabel="rms error after / before", yscale="log", xlim=(0.0, 1.0))
    winding.set(
        xlabel="external radius found (mm)", ylabel="wire radius found (mm)", yscale="log", xlim=(0.0, 120.0)
    )
    fig.legend(*winding.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return fig

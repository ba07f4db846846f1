from __future__ import annotations

import numpy as np
import torch
from matplotlib.colors import to_rgba
from matplotlib.patches import Rectangle

from estimator.field.winding import Winding
from estimator.reporting.plots import field_plane
from estimator.reporting.plots.style import WINDING


def test_field_plane_shows_field_width_readings_and_winding(words):
    radius_m, loops, pitch_m = (torch.tensor(v, dtype=torch.float64) for v in (0.05, 20.0, 1e-3))
    x_m, z_m = np.linspace(-0.08, 0.08, 21), np.linspace(-0.04, 0.1, 17)
    across, along = np.meshgrid(x_m, z_m)
    dipole = (
        np.stack((across, 0.0 * across, along + 0.2), axis=-1)
        / ((along + 0.2) ** 2 + across**2)[..., None] ** 2
    )
    fig = field_plane(
        x_m,
        z_m,
        1e-6 * dipole,
        0.001 + along**2,
        Winding(radius_m, loops, loops, pitch_m, pitch_m),
        readings_m=np.array([[0.0, 0.0, 0.05]]),
        title="rig, 2026-01-01, 3 A",
    )
    text = words(fig)
    for label in (
        "|B| (mT/A)",
        "90 % credible interval of |B| (%)",
        "x (mm)",
        "z (mm)",
        "sensor positions",
        "rig, 2026-01-01, 3 A",
    ):
        assert label in text
    for ax in fig.axes[:2]:
        assert ax.get_facecolor() == to_rgba(WINDING)  # visible where the field is NaN, inside a winding
        sections = [patch.get_bbox().bounds for patch in ax.patches if isinstance(patch, Rectangle)]
        assert np.allclose(sections, [(30.0, -20.0, 20.0, 20.0), (-50.0, -20.0, 20.0, 20.0)])

from __future__ import annotations

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.patches import Annulus, Rectangle

from estimator.errors import InvalidInput
from estimator.field.winding import Winding
from estimator.reporting.plots import (
    angular_deviation_map,
    before_and_after_map,
    relative_error_map,
    residual_map,
)

TITLE = "rig, 2026-01-01"
STEPS_M = np.linspace(-0.04, 0.04, 5)
GRID_M = np.stack(np.meshgrid(STEPS_M, STEPS_M, STEPS_M + 0.06, indexing="ij"), -1).reshape(-1, 3)


@pytest.fixture
def winding() -> Winding:
    radius_m, loops, pitch_m = (torch.tensor(v, dtype=torch.float64) for v in (0.05, 20.0, 1e-3))
    return Winding(radius_m, loops, loops, pitch_m, pitch_m)


def discs(ax: Axes) -> tuple[np.ndarray, np.ndarray]:
    (collection,) = (item for item in ax.collections if isinstance(item, EllipseCollection))
    return collection.get_offsets(), collection.get_array()


def tilted(positions_m: np.ndarray, angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return positions_m @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def test_residual_map_shows_both_planes_the_winding_and_the_noise(winding, words):
    fig = residual_map(GRID_M, np.full(GRID_M.shape, 1e-5), winding, sigma_T=1e-5, title=TITLE)
    text = words(fig)
    for label in (
        "XZ: median over y",
        "XY: median over z",
        "(µT)",
        "x (mm)",
        "y (mm)",
        "z (mm)",
        "noise\nalone",
        TITLE,
    ):
        assert label in text
    side, front = fig.axes[:2]
    assert [type(patch) for patch in side.patches] == [Rectangle, Rectangle]
    assert [type(patch) for patch in front.patches] == [Annulus]


def test_a_disc_is_the_median_over_the_hidden_axis(winding):
    residual_T = np.zeros(GRID_M.shape)
    residual_T[:, 0] = 1e-6 * np.where(GRID_M[:, 1] == STEPS_M[0], 100.0, 1e3 * (GRID_M[:, 0] + 0.05))
    side, front = residual_map(GRID_M, residual_T, winding).axes[:2]
    positions_mm, values_uT = discs(side)
    assert len(values_uT) == 25
    assert np.allclose(values_uT, positions_mm[:, 0] + 50.0)
    positions_mm, values_uT = discs(front)
    assert np.allclose(values_uT[positions_mm[:, 1] < -39.0], 100.0)


@pytest.mark.parametrize("angle_rad", [0.0, 0.03, -0.05])
def test_a_tilted_grid_keeps_its_layers(winding, angle_rad):
    fig = residual_map(tilted(GRID_M, angle_rad), np.ones(GRID_M.shape), winding)
    assert [len(discs(ax)[1]) for ax in fig.axes[:2]] == [25, 25]


def test_scattered_positions_become_a_raster(winding, words):
    positions_m = np.random.default_rng(0).uniform(-0.1, 0.1, (2000, 3))
    fig = residual_map(positions_m, np.ones(positions_m.shape), winding)
    words(fig)
    for ax in fig.axes[:2]:
        positions_mm, _ = discs(ax)
        assert len(np.unique(np.round(positions_mm[:, 0], 6))) == 24


def test_a_single_plane_with_jitter_stays_visible(winding, words):
    positions_m = GRID_M * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.03]
    positions_m[:, 2] += np.random.default_rng(0).normal(0.0, 1e-6, len(positions_m))
    fig = residual_map(positions_m, np.ones(positions_m.shape), winding)
    words(fig)
    positions_mm, values = discs(fig.axes[0])
    assert len(values) == 5
    assert np.allclose(positions_mm[:, 1], 30.0, atol=1e-2)
    assert np.allclose(fig.axes[0].collections[0].get_heights(), 0.92 * 20.0)


def test_one_position_can_be_drawn(winding, words):
    words(residual_map(GRID_M[:1], np.zeros((1, 3)), winding))


def test_relative_error_is_in_per_cent_of_the_measured_length(winding, words):
    measured_T = np.tile([3e-3, 0.0, 4e-3], (len(GRID_M), 1))
    measured_T[0] = 0.0
    fig = relative_error_map(GRID_M, measured_T, measured_T * 1.02, winding, title=TITLE)
    assert "(%)" in words(fig)
    assert np.allclose(discs(fig.axes[0])[1], 2.0)


def test_angle_is_in_mrad_and_needs_all_components(winding, words):
    measured_T = np.tile([0.0, 0.0, 4e-3], (len(GRID_M), 1))
    fig = angular_deviation_map(GRID_M, measured_T, tilted(measured_T, 0.005), winding, title=TITLE)
    assert "(mrad)" in words(fig)
    assert np.allclose(discs(fig.axes[0])[1], 5.0)
    measured_T[:, 0] = np.nan
    with pytest.raises(InvalidInput, match="mrad"):
        angular_deviation_map(GRID_M, measured_T, measured_T, winding)


def test_components_that_were_not_measured_do_not_count(winding):
    residual_T = np.tile([3e-6, np.nan, 4e-6], (len(GRID_M), 1))
    residual_T[::2] = np.nan
    values = discs(residual_map(GRID_M, residual_T, winding).axes[0])[1]
    assert np.allclose(values, 5.0)


def test_before_and_after_share_their_colours_and_positions(winding):
    before_T, after_T = np.full_like(GRID_M, 100e-6), np.full_like(GRID_M, 10e-6)
    figure = before_and_after_map(GRID_M, before_T, after_T, winding, 5e-6, TITLE)
    panels = [ax for ax in figure.axes if ax.get_title()]
    assert [ax.get_title().partition(",")[0] for ax in panels] == ["before", "before", "after", "after"]
    limits = {
        tuple(c.get_clim()) for ax in panels for c in ax.collections if isinstance(c, EllipseCollection)
    }
    assert len(limits) == 1
    assert np.allclose(discs(panels[0])[1], np.sqrt(3.0) * 100.0)
    assert np.allclose(discs(panels[2])[1], np.sqrt(3.0) * 10.0)
    assert np.array_equal(discs(panels[0])[0], discs(panels[2])[0])

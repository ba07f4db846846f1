from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.contour import ContourSet
from matplotlib.path import Path

from estimator.reporting.plots import corner
from estimator.reporting.plots.style import TRUTH

pytestmark = pytest.mark.whole


@pytest.fixture
def draws() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "coil1.radius_m": rng.normal(0.051, 3e-5, 3000),
        "coil1.world_from_coil.tilt_x_rad": rng.normal(0.0, 1e-3, 3000),
        "hall.noise_T": rng.normal(2e-5, 1e-6, 3000),
        "coil1.axial_loops": np.round(rng.normal(48.0, 0.6, 3000)),
        "coil1.radial_loops": np.round(rng.normal(25.0, 0.4, 3000)),
    }


def test_corner_has_one_panel_per_pair_and_shows_units(draws, words):
    text = words(fig := corner(draws, title="rig, 2026-01-01"))
    assert len(fig.axes) == 15
    for label in (
        "radius (mm)",
        "tilt x (mrad)",
        "noise (µT)",
        "axial loops",
        "68 %",
        "95 %",
        "rig, 2026-01-01",
    ):
        assert label in text
    assert "truth" not in text


def test_truth_and_point_estimate_are_marked_in_display_units(draws, words):
    only = {"coil1.radius_m": draws["coil1.radius_m"]}
    fig = corner(only, truth={"coil1.radius_m": 0.0515}, point={"coil1.radius_m": 0.051, "other": 1.0})
    at = {line.get_color(): line.get_xdata()[0] for line in fig.axes[0].lines}
    assert at[TRUTH] == pytest.approx(51.5)
    assert len(at) == 2
    assert fig.axes[0].get_xlim()[1] > 51.5
    below = corner(only, truth={"coil1.radius_m": 0.0505})
    assert below.axes[0].get_xlim()[0] < 50.5
    assert "point estimate" in words(fig)


def test_shaded_bars_of_the_interval_hold_68_per_cent(draws):
    bars = corner({"coil1.radius_m": draws["coil1.radius_m"]}).axes[0].patches
    shade = np.array([bar.get_facecolor()[2] for bar in bars])
    height = np.array([bar.get_height() for bar in bars])
    assert height[shade == shade.min()].sum() / height.sum() == pytest.approx(0.68, abs=0.05)


def test_contours_of_independent_normals_enclose_68_and_95_per_cent():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, 20000))
    panel = corner({"a.x_m": x * 1e-3, "a.y_m": y * 1e-3}).axes[1]
    rings = panel.collections[0]
    inside_95, inside_68 = (_share_inside(rings, i, x, y) for i in (0, 1))
    assert inside_68 == pytest.approx(0.68, abs=0.05)
    assert inside_68 + inside_95 == pytest.approx(0.95, abs=0.03)


def _share_inside(rings: ContourSet, i: int, x: np.ndarray, y: np.ndarray) -> float:
    polygons = rings.get_paths()[i].to_polygons()
    counts = sum(Path(polygon).contains_points(np.stack((x, y), 1)).astype(int) for polygon in polygons)
    return float(np.mean(counts % 2))


def test_a_count_that_is_certain_can_be_drawn(words):
    rng = np.random.default_rng(0)
    fig = corner({"c.radius_m": rng.normal(0.05, 1e-4, 500), "c.axial_loops": np.full(500, 48.0)})
    assert "48 (> 99 %)" in words(fig)


def test_labels_do_not_overlap_and_none_is_cut_off(draws):
    names = [
        f"coil{i}.{pose}.tilt_{axis}_rad"
        for i in (1, 2)
        for pose in ("world_from_coil0", "flange_from_coil")
        for axis in "xy"
    ]
    names += [f"coil{i}.wire_radius_m" for i in (1, 2)] + [
        "background_field[room].x_T",
        "sensor_offset[hall].x_T",
    ]
    for n in (2, 3, 6, 12):
        fig = corner(dict.fromkeys(names[:n], draws["coil1.radius_m"]), title="rig")
        canvas = FigureCanvasAgg(fig)
        canvas.draw()
        for axis in ("xaxis", "yaxis"):
            labels = [getattr(ax, axis).label for ax in fig.axes if getattr(ax, axis).label.get_text()]
            assert len(labels) == (n if axis == "xaxis" else n - 1)
            boxes = [label.get_window_extent(canvas.get_renderer()) for label in labels]
            for number, box in enumerate(boxes):
                assert fig.bbox.x0 <= box.x0 < box.x1 <= fig.bbox.x1, (n, axis, labels[number].get_text())
                assert fig.bbox.y0 <= box.y0 < box.y1 <= fig.bbox.y1, (n, axis, labels[number].get_text())
                assert not any(box.overlaps(other) for other in boxes[number + 1 :]), (n, axis)

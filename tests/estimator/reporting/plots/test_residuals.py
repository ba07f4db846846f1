from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.reporting.plots import (
    predicted_against_measured,
    residual_against,
    residual_by_sensor,
    residual_histogram,
)

SIGMA_T = 20e-6
TITLE = "rig $a$, 2026-01-01"


@pytest.fixture
def residual_T() -> np.ndarray:
    values = np.random.default_rng(0).normal(0.0, SIGMA_T, (200, 3))
    values[3, 1] = np.nan
    return values


def has_zero_line(ax: Axes, upright: bool = False) -> bool:
    data = [line.get_xdata() if upright else line.get_ydata() for line in ax.lines]
    return any(np.array_equal(values, [0.0, 0.0]) for values in data)


def noise_band(ax: Axes, upright: bool = False) -> tuple[float, float]:
    box = ax.patches[0].get_extents().transformed(ax.transData.inverted())
    return (box.x0, box.x1) if upright else (box.y0, box.y1)


def test_predicted_against_measured_shows_equality_and_residuals_with_zero_and_sigma(residual_T, words):
    measured_T = np.linspace(-5e-3, 5e-3, 600).reshape(200, 3) + residual_T
    ax = predicted_against_measured(measured_T, measured_T - residual_T, SIGMA_T, title=TITLE)
    text = words(ax)
    assert all(label in text for label in ("measured (mT)", "predicted (mT)", "residual (µT)", "± 1 sigma"))
    upper, lower = ax.child_axes
    equal = upper.lines[3]
    assert np.array_equal(equal.get_xdata(), equal.get_ydata())
    assert has_zero_line(lower)
    assert noise_band(lower) == pytest.approx((-20.0, 20.0))
    assert np.allclose(lower.lines[1].get_ydata(), residual_T[:, 0] * 1e6, equal_nan=True)


def test_residual_against_draws_into_given_axes_with_zero_sigma_and_units(residual_T, words):
    given = Figure(layout="constrained").add_subplot()
    ax = residual_against(np.arange(200.0), residual_T, SIGMA_T, "time (s)", ax=given, title=TITLE)
    assert ax is given
    text = words(ax)
    assert "time (s)" in text
    assert "residual (µT)" in text
    assert r"rig \$a\$, 2026-01-01" in text
    assert has_zero_line(ax)
    assert noise_band(ax) == pytest.approx((-20.0, 20.0))


def test_residual_against_counts_in_sigmas_where_sensors_differ(residual_T, words):
    sigma_T = np.where(np.arange(200)[:, None] < 100, 1e-5, 2e-5) * np.ones((1, 3))
    ax = residual_against(np.arange(200.0), residual_T, sigma_T, "time (s)")
    assert "residual (sigma)" in words(ax)
    assert noise_band(ax) == pytest.approx((-1.0, 1.0))


def test_histogram_is_whitened_and_shows_the_unit_normal(residual_T, words):
    ax = residual_histogram(residual_T, SIGMA_T, title=TITLE)
    text = words(ax)
    assert "residual / sigma" in text
    assert "unit normal" in text
    assert has_zero_line(ax, upright=True)
    assert noise_band(ax, upright=True) == pytest.approx((-1.0, 1.0))
    assert ax.lines[1].get_ydata().max() == pytest.approx(0.3989, rel=1e-3)


def test_every_component_of_a_sensor_is_held_against_the_sensors_own_noise(residual_T, words):
    sensor = np.arange(200) % 2
    residual_T[sensor == 1] *= 2.0
    residual_T[sensor == 1, 2] *= 2.0
    residual_T[sensor == 0, 2] = np.nan
    ax = residual_by_sensor(residual_T, sensor, ["hall", "$probe$", "unused"], SIGMA_T, title=TITLE)
    text = words(ax)
    assert "noise 20 µT" in text
    assert r"\$probe\$" in text
    assert has_zero_line(ax, upright=True)
    marks = [(line.get_ydata()[0], line.get_xdata()[0]) for line in ax.lines if len(line.get_xdata()) == 1]
    assert [row for row, _ in marks] == [0, 0, 1, 1, 1]
    assert [rms for _, rms in marks] == pytest.approx([1.0, 1.0, 2.0, 2.0, 4.0], rel=0.15)
    assert [label.get_text() for label in ax.get_legend().get_texts()] == ["Bx", "By", "Bz"]

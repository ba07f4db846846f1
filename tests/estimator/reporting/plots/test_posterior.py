from __future__ import annotations

import numpy as np
import pytest
from matplotlib.text import Text

from estimator.reporting.page import Picture
from estimator.reporting.plots import interval_summary, traces
from estimator.rig.parameters import Normal


def chain(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.05, 1e-4, (700, 8))


def test_bands_are_the_quantiles_over_walkers():
    ax = traces({"coil1.radius_m": chain()}).axes[0]
    outer, inner = (np.ptp(band.get_paths()[0].vertices[:, 1]) for band in ax.collections)
    assert outer > inner > 0.0
    median = ax.lines[-1].get_ydata()
    assert np.mean(median) == pytest.approx(50.0, abs=0.02)


@pytest.mark.parametrize("width_in", [10.0, 5.0])
def test_names_of_traces_do_not_overlap(width_in):
    causes = ("background_field[room]", "sensor_offset[hall]")
    fig = traces({f"{cause}.{axis}_T": chain() for cause in causes for axis in "xyz"})
    fig.set_size_inches(width_in, fig.get_figheight())
    fig.draw_without_rendering()
    boxes = [
        text.get_window_extent()
        for ax in fig.axes
        for text in (ax.yaxis.label, *(child for child in ax.get_children() if isinstance(child, Text)))
        if text.get_text()
    ]
    assert len(boxes) == 6
    assert not any(box.overlaps(other) for i, box in enumerate(boxes) for other in boxes[i + 1 :])


def test_traces_of_many_parameters_leave_room_in_a_page_of_a_megabyte():
    """Walkers that jump at random are the worst case; the other figures of a calibration take 0.45 MB."""
    chains = {f"coil1.p{i}_m": chain(i) for i in range(12)}
    assert len(Picture("Trace", "", traces(chains)).png_base64) < 550_000


def test_interval_summary_says_what_was_learnt_and_what_was_not(words):
    rng = np.random.default_rng(0)
    draws = {
        "coil1.radius_m": rng.normal(0.051, 1e-4, 4000),
        "coil1.spin_rad": rng.normal(0.0, 0.03, 4000),
        "derived.length_m": rng.normal(0.047, 1e-5, 4000),
    }
    prior = {"coil1.radius_m": Normal(0.048, 3e-3), "coil1.spin_rad": Normal(0.0, 0.03)}
    ax = interval_summary(draws, prior, truth={"coil1.radius_m": 0.051}, title="rig, 2026-01-01")
    text = words(ax)
    assert "51.00 ± 0.10 mm\n30 times narrower" in text
    assert "mrad\nlittle learnt" in text
    assert "prior standard deviations" in text
    assert "length" not in text


def test_interval_summary_scales_by_the_prior():
    draws = {"c.radius_m": np.random.default_rng(0).normal(0.051, 1e-3, 50_000)}
    ax = interval_summary(draws, {"c.radius_m": Normal(0.048, 2e-3)})
    posterior_95 = ax.patches[2]
    assert posterior_95.get_x() == pytest.approx(1.5 - 0.98, abs=0.02)
    assert posterior_95.get_width() == pytest.approx(2 * 0.98, abs=0.04)

"""Main effects and interactions: what is drawn is what the factorial says, in display units."""

from __future__ import annotations

import numpy as np
import pytest

from scripts.paper.factorial import Factorial
from scripts.paper.factorial_plots import interactions, main_effect, main_effects
from tests.estimator.reporting.plots.conftest import words

__all__ = ["words"]  # a fixture

RADIUS_M, LOOPS = np.linspace(0.048, 0.054, 7), np.linspace(45.0, 51.0, 4)


@pytest.fixture
def runs() -> Factorial:
    response = 1e-3 * (RADIUS_M[:, None] / 0.05) * LOOPS[None, :]
    return Factorial(("coil1.radius_m", "coil1.axial_loops"), (RADIUS_M, LOOPS), response)


def test_main_effect_shows_the_mean_at_every_level_in_mm_and_mT(runs, words):
    ax = main_effect(runs, "coil1.radius_m")
    np.testing.assert_allclose(ax.lines[0].get_xdata(), 1e3 * RADIUS_M)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), RADIUS_M / 0.05 * 48.0)
    said = words(ax)
    assert "radius (mm)" in said
    assert "rms field (mT)" in said


def test_figures_have_a_panel_for_each_parameter_and_each_pair(runs, words):
    drawn = main_effects(runs, "rig $a$")
    assert len(drawn.axes) == 2
    assert "rig \\$a\\$" in words(drawn)
    drawn = interactions(runs)
    assert len(drawn.axes) == 4
    legends = [ax.get_legend() for ax in drawn.axes]
    assert [legend is not None for legend in legends] == [False, True, False, True]
    assert [len(legend.get_texts()) for legend in legends if legend] == [len(RADIUS_M), len(LOOPS)]
    assert len({ax.get_ylim() for ax in drawn.axes}) == 1
    words(drawn)

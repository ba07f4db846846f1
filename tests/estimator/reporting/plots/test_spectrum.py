"""The spectrum of a coil without a winding shows every amplitude at its degree and size."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.reporting.plots import harmonic_spectrum

MEDIANS = {1: np.array([1e-3, -2e-4, 3e-5]), 2: np.array([5e-5, 1e-6, -4e-6, 2e-5, -7e-6])}
SDS = {1: np.full(3, 2e-7), 2: np.full(5, 6e-7)}
PRIORS = {1: 5e-3, 2: 2.5e-3}


def test_every_amplitude_is_a_point_at_its_degree_in_microtesla_per_ampere():
    ax = harmonic_spectrum(MEDIANS, SDS, PRIORS, title="magnet")
    prior, first, second = ax.lines
    for degree, points in ((1, first), (2, second)):
        np.testing.assert_allclose(points.get_ydata(), np.abs(MEDIANS[degree]) * 1e6)
        assert np.abs(np.asarray(points.get_xdata()) - degree).max() < 0.5
    assert prior.get_ydata() == pytest.approx([5e3, 2.5e3])
    (band,) = ax.patches
    assert band.get_data().values == pytest.approx([0.2, 0.6])
    assert ax.get_ylabel() == "|amplitude| (µT/A)"
    assert ax.get_yscale() == "log"

from __future__ import annotations

import numpy as np
import pytest

from estimator.reporting.plots.style import COMPONENT, sigma_unit


def test_residuals_are_shown_in_sigmas_only_where_the_noise_differs() -> None:
    assert sigma_unit(np.full((4, 3), 2e-5))[1:] == (pytest.approx(20.0), "µT")
    assert sigma_unit(np.array([[1e-5, 1e-5, 2e-5]]))[1:] == (1.0, "sigma")


def test_components_keep_three_different_colours() -> None:
    assert len(set(COMPONENT.values())) == 3

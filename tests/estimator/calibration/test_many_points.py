"""Intervals at many points: as those of all draws, also inside windings and for gradients, and refused where they would not hold."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.calibration import many_points, result
from estimator.calibration.many_points import N_CHECKED, N_TRIED, Combinations

ON = {"coil1": 3.0}
LEAST_OF_WIDTH = 3e-3


@pytest.mark.parametrize("method", ["field_interval", "gradient_interval"])
def test_intervals_at_many_points_are_those_of_all_draws(small_calibration, method, monkeypatch):
    monkeypatch.setattr(result, "INTERVAL_DRAWS", 80)
    monkeypatch.setattr(many_points, "MANY", 500)
    points_m = torch.from_numpy(np.random.default_rng(2).uniform(-0.06, 0.06, (1000, 3)))
    few = [end.numpy() for end in getattr(small_calibration, method)(points_m, ON, 0.8)]
    monkeypatch.setattr(many_points, "MANY", len(points_m) + 1)
    every = [end.numpy() for end in getattr(small_calibration, method)(points_m, ON, 0.8)]
    width = every[1] - every[0]
    for end, exact in zip(few, every, strict=True):
        assert (np.isnan(end) == np.isnan(exact)).all()
        off = np.abs(end - exact) / width
        assert np.nanmax(off) < LEAST_OF_WIDTH
        assert np.nanmax(np.abs(end - exact)) > 0.0  # it was another way
    assert np.isnan(few[0]).any()  # some points are inside the winding
    assert (few[0] <= few[1])[np.isfinite(few[0])].all()


def test_a_few_draws_stand_for_all_where_their_differences_are_few():
    rng = np.random.default_rng(1)
    differences = rng.normal(size=(60, 3)) @ rng.normal(size=(3, (N_TRIED + N_CHECKED) * 2))
    values = 1.0 + 1e-3 * differences.reshape(60, N_TRIED + N_CHECKED, 2)
    values[:, 7] = np.nan  # inside a winding
    combinations = Combinations.of(values)
    assert combinations is not None
    assert len(combinations.chosen) == 4
    ends = combinations.ends(values[combinations.chosen], 0.9)
    np.testing.assert_allclose(ends, np.quantile(values, [0.05, 0.95], axis=0), rtol=1e-7)


def test_values_that_differ_elsewhere_in_another_way_have_no_combinations():
    rng = np.random.default_rng(1)
    values = np.multiply.outer(rng.normal(size=60), rng.normal(size=(N_TRIED + N_CHECKED, 3)))
    assert Combinations.of(values) is not None
    values[:, -1] = rng.normal(size=(60, 3))
    assert Combinations.of(values) is None
    assert Combinations.of(np.ones_like(values)) is None

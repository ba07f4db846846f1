"""Clusters by k-means: those of SciPy, to the last bit, also where points of a grid are as far from two centres."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.cluster.vq import kmeans2

from estimator.readings.clusters import k_means


@pytest.mark.parametrize("n_columns", [1, 3, 4, 6])
@pytest.mark.parametrize("is_grid", [True, False])
@pytest.mark.filterwarnings("ignore:One of the clusters is empty")
def test_clusters_are_those_of_scipy(n_columns, is_grid):
    rng = np.random.default_rng(n_columns)
    points = rng.integers(0, 5, (600, n_columns)) / 4.0 if is_grid else rng.normal(size=(600, n_columns))
    points = np.unique(points, axis=0)
    n_clusters = min(20, len(points))
    expected = kmeans2(points, n_clusters, minit="++", rng=np.random.default_rng(3))
    for array, reference in zip(k_means(points, n_clusters, np.random.default_rng(3)), expected, strict=True):
        np.testing.assert_array_equal(array, reference)

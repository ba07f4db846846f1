"""Clusters of points by k-means, on NumPy: `scipy.cluster` takes a third of a second to load, as long as all the rest of an import."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce

import numpy as np
from jaxtyping import Float, Int

ROUNDS = 10  # of moving the centres; blocks of poses need no better ones
FEW_COLUMNS = 5  # from so many on a product of matrices is faster


def k_means(
    points: Float[np.ndarray, "point column"], n_clusters: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "cluster column"], Int[np.ndarray, " point"]]:
    """Centres of clusters, and the cluster of each point: those of `scipy.cluster.vq.kmeans2(..., minit="++")`.

    Args:
        points: A row each.
        n_clusters: At most as many as there are points; a cluster that loses its points keeps its centre.
        rng: Draws the first centres.
    References: Arthur and Vassilvitskii, SODA 2007 (k-means++).
    """
    centres = _first_centres(points, n_clusters, rng)
    for _ in range(ROUNDS):
        cluster = _squares(points, centres).argmin(axis=1)
        count = np.bincount(cluster, minlength=n_clusters)
        sums = [np.bincount(cluster, weights=column, minlength=n_clusters) for column in points.T]
        means = np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]
        centres = np.where(count[:, None] > 0, means, centres)
    return centres, cluster


def _first_centres(
    points: Float[np.ndarray, "point column"], n_clusters: int, rng: np.random.Generator
) -> Float[np.ndarray, "cluster column"]:
    """Points, each drawn with a probability that grows with the squared distance from those before."""
    rows = [int(rng.integers(len(points)))]
    nearest = np.full(len(points), np.inf)
    while len(rows) < n_clusters:
        nearest = np.minimum(nearest, _total((points.T - points[rows[-1], :, None]) ** 2))
        rows.append(int(np.searchsorted((nearest / nearest.sum()).cumsum(), rng.uniform())))
    return points[rows]


def _squares(
    points: Float[np.ndarray, "point column"], centres: Float[np.ndarray, "cluster column"]
) -> Float[np.ndarray, "point cluster"]:
    """Squared distance of each point from each centre; points of a grid are as far from two, and the order of the terms decides."""
    if points.shape[1] < FEW_COLUMNS:
        return _total((x[:, None] - centre) ** 2 for x, centre in zip(points.T, centres.T, strict=True))
    of_point, of_centre = (_total(column**2 for column in each.T) for each in (points, centres))
    return -2.0 * (points @ centres.T) + of_point[:, None] + of_centre


def _total(terms: Iterable[np.ndarray]) -> np.ndarray:
    return reduce(np.add, terms)

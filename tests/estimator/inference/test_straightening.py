"""Straightening: the map that log densities were made with is found again, and stays sensible where little is known."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.inference.straightening import Straightening

N = 5


def weights(size: int) -> np.ndarray:
    return np.full(size, 1.0 / size)


def bent_log_density(white: np.ndarray) -> np.ndarray:
    """A normal law, its third coordinate of half the spread, its last one bent along two others and moved."""
    straight = white.copy()
    straight[:, 2] *= 2.0
    straight[:, -1] -= 0.3 + 0.2 * white[:, 1] + 0.25 * white[:, 0] ** 2 - 0.15 * white[:, 0] * white[:, 3]
    return -0.5 * (straight**2).sum(1)


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.RandomState(0).standard_normal((600, N))


@pytest.fixture(scope="module")
def found(points) -> Straightening:
    return Straightening.fitted(points, bent_log_density(points), weights(600), np.zeros(600, dtype=int))


def test_map_is_found_again_from_log_densities(found):
    bend = found.bend
    np.testing.assert_allclose(found.spread, [1.0, 1.0, 0.5, 1.0, 1.0], rtol=2e-3)
    assert bend.offset[-1] == pytest.approx(0.3, abs=2e-3)
    assert bend.slope[-1, 1] == pytest.approx(0.2, abs=2e-3)
    assert bend.curvature[-1, 0, 0] == pytest.approx(0.25, abs=2e-3)
    assert bend.curvature[-1, 3, 0] == pytest.approx(-0.15, abs=2e-3)
    assert np.abs(bend.curvature[:-1]).max() < 2e-3


def test_straight_coordinates_are_normal_at_points_that_took_no_part(found):
    fresh = np.random.RandomState(1).standard_normal((1000, N))
    straight = found.bend.straightened(fresh) / found.spread
    off = bent_log_density(fresh) + 0.5 * (straight**2).sum(1)
    assert off.std() < 0.02
    np.testing.assert_allclose(found.bend.bent(found.bend.straightened(fresh)), fresh, atol=1e-12)


def test_points_without_weight_do_not_count(points, found):
    """Half of them with log densities of another law."""
    other = np.random.RandomState(2).standard_normal((600, N))
    weight = np.concatenate((weights(600), np.zeros(600)))
    log_density = np.concatenate((bent_log_density(points), -50.0 * other[:, 0] ** 2))
    again = Straightening.fitted(
        np.concatenate((points, other)), log_density, weight, np.zeros(1200, dtype=int)
    )
    np.testing.assert_allclose(again.coefficients, found.coefficients, atol=1e-8)


def test_points_too_far_for_numbers_do_not_count(points, found):
    far = np.concatenate((points, np.full((1, N), 1e200)))
    weight = np.append(0.9 * weights(600), 0.1)
    log_density = np.append(bent_log_density(points), 0.0)
    again = Straightening.fitted(far, log_density, weight, np.zeros(601, dtype=int))
    np.testing.assert_allclose(again.coefficients, found.coefficients, atol=1e-8)
    alone = Straightening.fitted(far[-1:], log_density[-1:], np.ones(1), np.zeros(1, dtype=int))
    np.testing.assert_array_equal(alone.coefficients, 0.0)


def test_products_of_many_coordinates_are_found_among_thousands():
    """A sensor's zero bends along a field times two angles; 3 of 6512 terms, by fewer points than terms."""
    n, size = 32, 3000
    white = np.random.RandomState(5).standard_normal((size, n))

    def log_density(points: np.ndarray) -> np.ndarray:
        straight = points.copy()
        straight[:, 30] -= 0.5 * points[:, 27] * points[:, 3] - 0.4 * points[:, 27] * points[:, 4]
        straight[:, 20] -= 0.3 * points[:, 2] ** 2
        return -0.5 * (straight**2).sum(1)

    fitted = Straightening.fitted(white, log_density(white), weights(size), np.zeros(size, dtype=int))
    assert fitted.bend.curvature[30, 27, 3] == pytest.approx(0.5, abs=0.01)
    assert fitted.bend.curvature[30, 27, 4] == pytest.approx(-0.4, abs=0.01)
    assert fitted.bend.curvature[20, 2, 2] == pytest.approx(0.3, abs=0.01)
    fresh = np.random.RandomState(6).standard_normal((1000, n))
    off = log_density(fresh) + 0.5 * ((fitted.bend.straightened(fresh) / fitted.spread) ** 2).sum(1)
    assert off.std() < 0.3

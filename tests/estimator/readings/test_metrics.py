"""Error metrics, each against a number worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimator.readings.metrics import angular_deviation_rad, error_metrics

NAN = float("nan")


def test_two_full_readings_by_hand():
    measured = np.array([[3.0, 0.0, 4.0], [0.0, 2.0, 0.0]])
    predicted = np.array([[3.0, 0.0, 1.0], [4.0, 2.0, 0.0]])
    result = error_metrics(measured, predicted)  # error vectors (0, 0, 3) and (-4, 0, 0)
    assert result.vector_T == pytest.approx(math.sqrt((9 + 16) / 2))
    assert result.paper_metric_T == pytest.approx(0.5 * math.sqrt((9 + 16) / 2))
    assert result.component_T == pytest.approx(math.sqrt((9 + 16) / 6))
    assert result.max_T == 4.0
    assert result.relative == pytest.approx(math.sqrt((9 + 16) / 2) / math.sqrt((25 + 4) / 2))
    assert result.angular_deviation_rad == pytest.approx((math.atan2(9, 13) + math.atan2(8, 4)) / 2)


def test_components_that_were_not_measured_do_not_count():
    measured = np.array([[NAN, NAN, 1.0], [0.0, 2.0, NAN]])
    predicted = np.array([[50.0, 60.0, 1.5], [0.0, 1.0, 70.0]])
    result = error_metrics(measured, predicted)  # errors 0.5; 0 and 1
    assert result.vector_T == pytest.approx(math.sqrt((0.25 + 1.0) / 2))
    assert result.component_T == pytest.approx(math.sqrt((0.25 + 1.0) / 3))
    assert result.max_T == 1.0
    assert result.relative == pytest.approx(math.sqrt(1.25 / 2) / math.sqrt((1 + 4) / 2))
    assert math.isnan(result.angular_deviation_rad)


def test_a_reading_without_any_component_does_not_count():
    measured, predicted = np.array([[1.0, 2.0, 3.0]]), np.array([[1.5, 2.0, 3.0]])
    empty = np.array([[NAN, NAN, NAN]])
    assert error_metrics(
        np.concatenate([measured, empty]), np.concatenate([predicted, predicted])
    ) == error_metrics(measured, predicted)


def test_the_angle_is_over_whole_readings_only():
    measured = np.array([[1.0, 0.0, 0.0], [NAN, 1.0, 0.0]])
    predicted = np.array([[1.0, 1.0, 0.0], [5.0, 1.0, 0.0]])
    assert error_metrics(measured, predicted).angular_deviation_rad == pytest.approx(math.pi / 4)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 0.3, math.pi / 2, math.pi - 1e-9, math.pi])
def test_angles_keep_their_digits_at_both_ends(angle_rad):
    measured = np.array([[2.0, 0.0, 0.0]])
    predicted = 3.0 * np.array([[math.cos(angle_rad), 0.0, math.sin(angle_rad)]])
    assert angular_deviation_rad(measured, predicted)[0] == pytest.approx(angle_rad, rel=1e-6, abs=1e-15)


@pytest.mark.parametrize("measured", [np.zeros((0, 3)), np.full((2, 3), NAN)])
def test_no_readings_have_no_errors(measured):
    result = error_metrics(measured, np.ones_like(measured))
    assert all(math.isnan(value) for value in vars(result).values())


def test_no_field_has_no_relative_error():
    result = error_metrics(np.zeros((1, 3)), np.ones((1, 3)))
    assert math.isnan(result.relative)
    assert result.vector_T == pytest.approx(math.sqrt(3))


def test_a_perfect_prediction_has_no_error():
    measured = np.array([[1e-3, -2e-3, 5e-4]])
    assert set(vars(error_metrics(measured, measured)).values()) == {0.0}


def test_angles_are_of_readings_with_a_current():
    """What is read without one is noise, which points anywhere."""
    measured_T = np.array([[0.0, 0.0, 1.0], [1e-5, 0.0, 0.0]])
    predicted_T = np.array([[0.0, 0.1, 1.0], [0.0, 1e-5, 0.0]])
    of_all, of_powered, of_none = (
        error_metrics(measured_T, predicted_T, is_on)
        for is_on in (None, np.array([True, False]), np.array([False, False]))
    )
    assert of_powered.angular_deviation_rad == pytest.approx(np.arctan(0.1))
    assert of_all.angular_deviation_rad == pytest.approx(0.5 * (np.arctan(0.1) + 0.5 * np.pi))
    assert np.isnan(of_none.angular_deviation_rad)
    assert of_powered.vector_T == of_all.vector_T == of_none.vector_T

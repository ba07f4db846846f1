"""Error metrics of predictions, as the field reports them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Half-width of the central 90 % interval of a normal distribution, in standard deviations.
HALF_WIDTH_90 = 1.644854


@dataclass(frozen=True)
class ErrorMetrics:
    """Error metrics over one set of readings; NaN if the set has no suitable readings.

    Attributes:
        paper_metric_T: Half the root mean square of the error vectors (eq 2, 3 with the 1/2 outside the root, as the paper computes).
        vector_T: Root mean square length of the error vectors.
        component_T: Root mean square error of single components.
        max_T: Largest length of an error vector.
        relative: `vector_T` over the root mean square length of the measured vectors.
        angular_deviation_rad: Mean angle between measured and predicted vector, over readings with all three components and with a
            current: what is read without one has hardly a direction.
    """

    paper_metric_T: float
    vector_T: float
    component_T: float
    max_T: float
    relative: float
    angular_deviation_rad: float


def error_metrics(
    measured_T: np.ndarray, predicted_T: np.ndarray, is_on: np.ndarray | None = None
) -> ErrorMetrics:
    """Error metrics of predicted readings; components that are NaN were not measured and do not count.

    Args:
        measured_T, predicted_T: Readings, shape (reading, 3).
        is_on: Which of them were taken with a current in some coil, shape (reading,); all where it is not given.
    Examples:
        >>> result = error_metrics(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.1, 1.0]]))
        >>> round(result.vector_T, 3), round(result.paper_metric_T, 3), round(result.angular_deviation_rad, 4)
        (0.1, 0.05, 0.0997)
    """
    has_component = np.isfinite(measured_T).any(axis=1)
    is_on = np.ones(len(measured_T), dtype=bool) if is_on is None else is_on
    measured_T, predicted_T, is_on = (rows[has_component] for rows in (measured_T, predicted_T, is_on))
    if not len(measured_T):
        return ErrorMetrics(*[float("nan")] * 6)
    difference = measured_T - predicted_T
    squared = np.nansum(difference**2, axis=1)
    vector_T = float(np.sqrt(squared.mean()))
    has_angle = np.isfinite(measured_T).all(axis=1) & is_on
    field_T = float(np.sqrt(np.nansum(measured_T**2, axis=1).mean()))
    return ErrorMetrics(
        0.5 * vector_T,
        vector_T,
        float(np.sqrt(np.nanmean(difference**2))),
        float(np.sqrt(squared.max())),
        vector_T / field_T if field_T > 0.0 else float("nan"),
        float(angular_deviation_rad(measured_T[has_angle], predicted_T[has_angle]).mean())
        if has_angle.any()
        else float("nan"),
    )


def angular_deviation_rad(measured_T: np.ndarray, predicted_T: np.ndarray) -> np.ndarray:
    """Angle between measured and predicted vectors; NaN for partial readings. By atan2, so that small angles keep their digits."""
    cross = np.linalg.norm(np.cross(measured_T, predicted_T), axis=1)
    return np.asarray(np.arctan2(cross, (measured_T * predicted_T).sum(axis=1)))

"""The noise of a sensor by its own readings: their scatter at one place, about a line in the currents."""

from __future__ import annotations

from estimator.readings.observations import Observations
from estimator.tensors import Tensor, torch

MOST_SCATTER = 40.0  # variance of a place over the median of all: of one degree of freedom one in 40,000 has more by chance
FEWEST = 30  # degrees of freedom from which on the scatter counts; it is then known to an eighth


def scatter_T(observations: Observations, n_sensors: int) -> list[float | None]:
    """Standard deviation of a component of each sensor's readings; None where too few places were read often enough.

    At one place every field is a constant and a share of each current. What readings scatter about that is noise, whatever the model.

    Args:
        observations: Readings; those at the same place have the same motion to the last bit.
        n_sensors: Of the rig.
    """
    settings = [observations.sensor[:, None].to(torch.float64), *observations.motion.values()]
    _, place = torch.unique(torch.cat(settings, dim=1), dim=0, return_inverse=True)
    order = torch.argsort(place, stable=True)
    groups = torch.split(order, torch.bincount(place).tolist())
    is_measured = observations.is_measured  # looks at all readings
    by_sensor: list[list[tuple[float, int]]] = [[] for _ in range(n_sensors)]
    for rows in (rows for rows in groups if len(rows) >= 2):
        of_sensor = by_sensor[int(observations.sensor[rows[0]])]
        for axis in range(3):
            read = rows[is_measured[rows, axis]]
            if len(read) >= 2:
                of_sensor.append(
                    _about_a_line(observations.current_A[read], observations.field_sensor_T[read, axis])
                )
    return [_pooled_T([(left, n) for left, n in of_sensor if n]) for of_sensor in by_sensor]


def _pooled_T(groups: list[tuple[float, int]]) -> float | None:
    """Standard deviation by sums of squares and their degrees of freedom; those of places that were written down wrongly do not count."""
    if not groups:
        return None
    left, n_free = (torch.tensor(each, dtype=torch.float64) for each in zip(*groups, strict=True))
    counts = left <= MOST_SCATTER * (left / n_free).median() * n_free
    n = float(n_free[counts].sum())
    return float((left[counts].sum() / n).sqrt()) if n >= FEWEST else None


def _about_a_line(current_A: Tensor, field_T: Tensor) -> tuple[float, int]:
    """Sum of squares that a constant and the currents leave, and its degrees of freedom."""
    columns = torch.cat((torch.ones_like(current_A[:, :1]), current_A), dim=1)
    columns = columns / columns.abs().amax(dim=0).clamp(min=1e-300)
    span, size, _ = torch.linalg.svd(columns, full_matrices=False)
    span = span[:, size > 1e-9 * size.max().clamp(min=1e-300)]
    left = field_T - span @ (span.mT @ field_T)
    return float(left.square().sum()), len(field_T) - span.shape[1]

"""Residuals of a fit by current, component, height and sensor: where they are larger than the noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimator.calibration.fitted import fitted
from estimator.calibration.result import Calibration

FEWEST = 5  # readings of a group
MOST_CURRENTS = 8  # settings that are told one by one; more are told by their thirds
SAME_SETTING = 0.01  # of a coil's largest current: what a meter shows of one setting scatters
N_HEIGHTS = 3


@dataclass(frozen=True)
class Group:
    """Residuals of some readings, in units of the noise.

    Attributes:
        by: What the readings are grouped by.
        name: Of the group.
        n_readings: How many there are.
        rms_sigma: Root mean square over components; about 1 where the model holds.
        mean_sigma: Mean of x, y and z; None where a component was not measured.
    """

    by: str
    name: str
    n_readings: int
    rms_sigma: float
    mean_sigma: list[float | None]


def residual_groups(calibration: Calibration) -> list[Group]:
    """Groups of the readings of the fit, those with few readings left out.

    Args:
        calibration: Its readings are grouped by the current of each coil, by the height of the sensor in the frame of each coil, and by
            sensor; all of them together have one row for each component.
    """
    fit, o = fitted(calibration), calibration.observations.calibration
    in_sigma = fit.residual_T / fit.sigma_T
    groups = list[Group]()
    for axis, name in enumerate("xyz"):
        only = np.full_like(in_sigma, np.nan)
        only[:, axis] = in_sigma[:, axis]
        groups += _group("component", f"B{name}", only, np.asarray(np.isfinite(only).any(axis=1)))
    for i, coil in enumerate(calibration.rig.coils):
        current_A = o.current_A[:, i].numpy()
        for label, rows in _by_value(current_A):
            groups += _group(f"current of {coil.name}", label, in_sigma, np.asarray(rows))
        rows_on = fit.model.powered[coil.name]
        if len(rows_on):
            position_m, _ = fit.model.readings_in_coil(coil, fit.best)
            groups += _by_height(coil.name, position_m[:, 2].numpy(), np.abs(current_A) > 0.0, in_sigma)
    if len(calibration.rig.sensors) > 1:
        for i, sensor in enumerate(calibration.rig.sensors):
            groups += _group("sensor", sensor.name, in_sigma, o.sensor.numpy() == i)
    return groups


def _by_value(current_A: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    order = np.argsort(current_A)
    gaps_A = np.diff(current_A[order])
    settings = np.split(order, np.flatnonzero(gaps_A > SAME_SETTING * np.abs(current_A).max()) + 1)
    if len(settings) < 2:
        return
    if len(settings) <= MOST_CURRENTS:
        for rows in settings:
            yield f"{current_A[rows].mean() + 0.0:.4g} A", np.isin(np.arange(len(current_A)), rows)
        return
    edges = np.quantile(current_A, np.linspace(0.0, 1.0, N_HEIGHTS + 1))
    for low, high in pairwise(edges):
        yield f"{low:.3g} to {high:.3g} A", (current_A >= low) & (current_A <= high)


def _by_height(coil: str, z_m: np.ndarray, is_on: np.ndarray, in_sigma: np.ndarray) -> Iterator[Group]:
    if not is_on.any() or np.ptp(z_m[is_on]) < 1e-6:
        return
    edges = np.quantile(z_m[is_on], np.linspace(0.0, 1.0, N_HEIGHTS + 1))
    for i, (low, high) in enumerate(pairwise(edges)):
        is_here = is_on & (z_m >= low) & ((z_m < high) if i < N_HEIGHTS - 1 else (z_m <= high))
        name = f"{1e3 * low:.3g} to {1e3 * high:.3g} mm"
        yield from _group(f"height over {coil}", name, in_sigma, is_here)


def _group(by: str, name: str, in_sigma: np.ndarray, rows: np.ndarray) -> Iterator[Group]:
    own = in_sigma[rows]
    if len(own) < FEWEST or not np.isfinite(own).any():
        return
    known = np.isfinite(own)
    counts = known.sum(axis=0)
    sums = np.where(known, own, 0.0).sum(axis=0)
    means = [float(total / n) if n else None for total, n in zip(sums, counts, strict=True)]
    yield Group(by, name, len(own), float(np.sqrt(np.mean(own[known] ** 2))), means)

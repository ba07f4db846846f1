"""What the page of the service shows of a calibration, as numbers in SI: sentences, fields, what the data taught, residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.calibration.fitted import fitted
from estimator.calibration.planes import coil_planes
from estimator.calibration.residual_groups import Group, residual_groups
from estimator.calibration.result import Calibration
from estimator.calibration.sentences import verdict_sentences, warning_sentences
from estimator.calibration.summary import finite
from estimator.reporting.numbers import displays

PLANE_POINTS = 41


@dataclass(frozen=True)
class Taught:
    """What the readings told of a parameter: posterior in standard deviations of the prior, from its centre; `words` are its short name."""

    name: str
    words: str
    middle: float
    low: float
    high: float


@dataclass(frozen=True)
class FieldPlane:
    """Field of a coil for one ampere in the plane y = 0 of its frame.

    Attributes:
        coil: Its name.
        x_m, z_m: Coordinates, evenly spaced.
        size_T_per_A: Rows of |B|, one for each z; None inside a winding.
        relative: Half-width of the 90 % interval of |B| over |B|, likewise.
    """

    coil: str
    x_m: list[float]
    z_m: list[float]
    size_T_per_A: list[list[float | None]]
    relative: list[list[float | None]]


@dataclass(frozen=True)
class CalibrationPanels:
    """What the page shows.

    Attributes:
        headline: Sentences, the first one large.
        warnings: What a reader must not overlook.
        verdict: `good`, `suspect` or `unusable`; None in files of 0.1.
        taught: Of every free parameter.
        planes: Fields of the coils that carried current.
        rms_sigma: Residual of each reading of the fit, in units of the noise.
        groups: Residuals by current, axis, height and sensor.
        coils: Names of all coils, in order.
        movers: Columns of each mover.
    """

    headline: list[str]
    warnings: list[str]
    verdict: str | None
    taught: list[Taught]
    planes: list[FieldPlane]
    rms_sigma: list[float | None]
    groups: list[Group]
    coils: list[str]
    movers: dict[str, list[str]]


def calibration_panels(calibration: Calibration) -> CalibrationPanels:
    """Compute the panels of a calibration."""
    fit, summary, rig = fitted(calibration), calibration.summary(), calibration.rig
    in_sigma = fit.residual_T / fit.sigma_T
    known = np.isfinite(in_sigma)
    squares = np.where(known, in_sigma, 0.0) ** 2
    counts = known.sum(axis=1)
    rms = np.sqrt(squares.sum(axis=1) / np.maximum(counts, 1))
    taught, words = [], displays([parameter.name for parameter in rig.free])
    for parameter in rig.free:
        prior, draws = parameter.prior, calibration.draws[parameter.name]
        if prior is not None:
            low, middle, high = ((np.quantile(draws, q) - prior.centre) / prior.sd for q in (0.05, 0.5, 0.95))
            taught.append(
                Taught(parameter.name, words[parameter.name].words, float(middle), float(low), float(high))
            )
    planes = [
        FieldPlane(
            plane.coil,
            plane.x_m.tolist(),
            plane.z_m.tolist(),
            _listed(np.linalg.norm(plane.field_T_per_A, axis=-1)),
            _listed(plane.relative),
        )
        for plane in coil_planes(calibration, PLANE_POINTS)
    ]
    quality = summary.get("quality")
    return CalibrationPanels(
        verdict_sentences(calibration),
        warning_sentences(summary),
        None if quality is None else str(quality["verdict"]),
        taught,
        planes,
        [float(value) if n else None for value, n in zip(rms, counts, strict=True)],
        residual_groups(calibration),
        [coil.name for coil in rig.coils],
        {mover.name: list(mover.columns) for mover in rig.movers},
    )


def _listed(rows: np.ndarray) -> list[list[float | None]]:
    return [[finite(value) for value in row] for row in rows]

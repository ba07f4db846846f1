"""A field map of a simulation against the coil model, on the readings of a session."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import effort, policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.covariates import residual_T, sensor_in_coils
from estimator.diagnosis.structure.residual_tests import LackOfFit, Structure, lack_of_fit, structure
from estimator.diagnosis.validation import Improvement, improvement_of
from estimator.errors import InvalidInput
from estimator.field.grid_map import GridMap
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.model.bodies import SIDED_KEYS, WINDING_KEYS
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.split import thinned, with_validation
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.session import Session

# Below, a residual has structure, or is larger than the noise, by more than chance makes once in a hundred sessions
LEAST_P = 0.01
COARSE = 0.3  # of the noise: an error of interpolation beyond which the map is judged with a warning
FEWEST_READINGS = 10
N_SHELLS = 4


class Explained(StrEnum):
    """Which description leaves nothing but noise."""

    BOTH = "both"
    COIL_MODEL = "coil_model"
    MAP = "map"
    NEITHER = "neither"


@dataclass(frozen=True)
class Rival:
    """How well one description fits.

    Attributes:
        fit: To the readings that it was fitted to.
        lack_of_fit: Size of the residual against the noise.
        structure: Its dependence on covariates, the most striking first.
    """

    fit: Fit
    lack_of_fit: LackOfFit
    structure: tuple[Structure, ...]

    @classmethod
    def of(cls, fit: Fit, seed: int) -> Rival:
        """Judge a fit."""
        return cls(fit, lack_of_fit(fit), tuple(structure(fit, seed)))

    @property
    def explains(self) -> bool:
        """Whether its residual is noise, as far as these readings tell."""
        return self.structure[0].p_value >= LEAST_P and self.lack_of_fit.p_value >= LEAST_P

    @property
    def residual_T(self) -> Float[Tensor, "reading 3"]:
        """Measured less predicted; NaN where a component was not measured."""
        return residual_T(self.fit)

    def to_json(self) -> dict[str, Any]:
        """How well this description fits, in the form of `comparison.json`."""
        return {
            "explains": self.explains,
            "rms_T": self.lack_of_fit.rms_T,
            "noise_T": self.lack_of_fit.noise_T,
            "noise_from": self.lack_of_fit.noise_from,
            "p_value": self.lack_of_fit.p_value,
            "structure": [
                {"along": test.covariate.name, "p_value": test.p_value, "share": test.share}
                for test in self.structure
                if test.p_value < LEAST_P
            ],
        }


@dataclass(frozen=True)
class Shell:
    """Readings at some distances from the origin of the coil's frame, and the rms residual of each description there."""

    nearest_m: float
    farthest_m: float
    readings: int
    coil_model_T: float
    map_T: float


@dataclass(frozen=True)
class Comparison:
    """The result.

    Attributes:
        coil: Whose field the map has.
        coil_model, map: Both descriptions.
        improvement: Of the log predictive density by the map, on readings that neither has seen; None where none were kept out.
        interpolation_error_T: Rms difference at the readings between all points of the map and every second one along each axis, over
            fifteen, by which the error of a smooth field falls when the spacing halves.
        outside: Readings beyond the map, which were left out.
        shells: Where the residuals are.
    """

    coil: str
    coil_model: Rival
    map: Rival
    improvement: Improvement | None
    interpolation_error_T: float
    outside: int
    shells: tuple[Shell, ...]

    @property
    def explained(self) -> Explained:
        """Which description explains the readings."""
        both = (self.coil_model.explains, self.map.explains)
        return {
            (True, True): Explained.BOTH,
            (True, False): Explained.COIL_MODEL,
            (False, True): Explained.MAP,
            (False, False): Explained.NEITHER,
        }[both]

    @property
    def is_coarse(self) -> bool:
        """Whether the error of interpolation may pass for a fault of the map."""
        return self.interpolation_error_T > COARSE * self.map.lack_of_fit.noise_T

    def to_json(self) -> dict[str, Any]:
        """Content of `comparison.json`."""
        better = self.improvement
        return {
            "coil": self.coil,
            "explained_by": str(self.explained),
            "coil_model": self.coil_model.to_json(),
            "map": self.map.to_json(),
            "elpd_difference": None if better is None else better.elpd_difference,
            "elpd_se": None if better is None else better.elpd_se,
            "interpolation_error_T": self.interpolation_error_T,
            "is_coarse": self.is_coarse,
            "readings": len(self.map.fit.observations),
            "outside": self.outside,
            "shells": [vars(shell) for shell in self.shells],
        }


def compare(session: Session, field_map: GridMap, coil: str | None = None, *, seed: int = 0) -> Comparison:
    """Fit the rig twice, once with its winding and once with a map in its place, and judge both residuals.

    The map is taken as it is: it has the poses, supplies and sensors of the rig to fit, but no number of its own.

    Args:
        session: Readings. Those marked as validation are kept out of the fits; where none is marked, a fifth is, in blocks.
        field_map: Field per ampere in the frame of the coil: on its front face, z away from it.
        coil: Which coil it describes; may be left out where there is one.
        seed: Of the split, the starts and the noise that residuals are compared with.
    Raises:
        InvalidInput: No such coil, nothing free to fit, or too few readings within the map.
    """
    rig = session.rig
    coil = _coil(rig, coil)
    rig.check_free()
    observations = with_validation(session.observations, policy.VALIDATION_SHARE, seed)
    rules = MeasurementModel.build(rig, observations).rules
    rough = fit_rig(
        rig,
        thinned(observations.calibration, effort.MOST_READINGS_SEARCHED, seed),
        {},
        rules,
        effort.MORE_STARTS,
    )
    within = _within(rough, observations, field_map, coil)
    seen, unseen = (part.rows(inside) for part, inside in within)
    outside = sum(int((~inside).sum()) for _, inside in within)
    if len(seen) < FEWEST_READINGS:
        raise InvalidInput(
            f"field map must hold at least {FEWEST_READINGS} readings for the fit; it holds {len(seen)}, and {outside} lie outside"
        )
    seen = thinned(seen, effort.MOST_READINGS_FITTED, seed)
    by_winding = fit_rig(rig, seen, rough.values, rules)
    by_map = _fit_with_map(by_winding, field_map, coil)
    improvement = improvement_of(by_winding, by_map, unseen) if len(unseen) else None
    rivals = Rival.of(by_winding, seed), Rival.of(by_map, seed)
    return Comparison(
        coil,
        *rivals,
        improvement,
        _interpolation_error_T(by_map, field_map, coil),
        outside,
        _shells(*rivals, coil),
    )


def _coil(rig: Rig, coil: str | None) -> str:
    names = [each.name for each in rig.wound]
    if coil is None and len(names) == 1:
        return names[0]
    if coil not in names:
        raise InvalidInput(f"coil of the map must be one of {', '.join(names)}; received {coil or 'none'}")
    return coil


def _within(
    fit: Fit, observations: Observations, field_map: GridMap, coil: str
) -> list[tuple[Observations, Tensor]]:
    """Readings for the fit and for validation, each with which of them have the sensor within the map."""
    parts = []
    for part in (observations.calibration, observations.validation):
        body = next(each for each in fit.rig.coils if each.name == coil)
        position_m = fit.model_of(part).readings_in_coil(body, fit.values)[0]
        parts.append((part, field_map.holds(position_m.detach())))
    return parts


def _fit_with_map(start: Fit, field_map: GridMap, coil: str) -> Fit:
    """The fit with the map, from the poses of another fit; the numbers of the winding have no say any more."""
    rig = start.rig.with_values({p.name: float(start.values[p.name]) for p in start.rig.free})
    own = {f"{coil}.{key}" for key in (*WINDING_KEYS, *SIDED_KEYS, "wire_radius_m")}
    # Another coil needs them.
    tied = {p.tie.to for p in rig.parameters.values() if p.tie and p.name not in own}
    rig = rig.with_fixed(p.name for p in rig.free if p.name in own - tied)
    if not rig.free:
        raise InvalidInput(
            f"rig {rig.name!r} must leave something free besides the winding of {coil}, such as its pose"
        )
    observations = start.observations
    model = (
        MeasurementModel.unruled(rig, observations)
        .with_rules(start.posterior.model.rules)
        .with_maps({coil: field_map})
    )
    coordinates = Coordinates(rig)
    posterior = LogPosterior(coordinates, model, observations)
    return Fit(
        posterior, levenberg_marquardt(posterior, coordinates.start()[None], tolerance=effort.FINE_TOLERANCE)
    )


def _interpolation_error_T(fit: Fit, field_map: GridMap, coil: str) -> float:
    model = fit.posterior.model
    with torch.no_grad():
        fine_T, coarse_T = (
            model.with_maps({coil: each}).predict(fit.values) for each in (field_map, field_map.coarser())
        )
    return float((fine_T - coarse_T).square().mean().sqrt()) / 15.0


def _shells(coil_model: Rival, by_map: Rival, coil: str) -> tuple[Shell, ...]:
    distance_m = sensor_in_coils(coil_model.fit)[coil].norm(dim=-1)
    residuals_T = (coil_model.residual_T, by_map.residual_T)
    shells = []
    for rows in distance_m.argsort().tensor_split(N_SHELLS):
        rms_T = [float(residual_T[rows].square().nanmean().sqrt()) for residual_T in residuals_T]
        shells.append(
            Shell(float(distance_m[rows].min()), float(distance_m[rows].max()), len(rows), rms_T[0], rms_T[1])
        )
    return tuple(shells)

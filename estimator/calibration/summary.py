"""The result of a calibration in numbers, as `summary.json` holds it (docs/file-formats.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from estimator.calibration import policy
from estimator.calibration.quality import assessment
from estimator.calibration.result import Calibration
from estimator.inference.convergence import convergence
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.metrics import ErrorMetrics, error_metrics
from estimator.readings.observations import Observations
from estimator.rig.bodies import Coil, SidedCoil
from estimator.rig.coordinates import Coordinates, nominal_tensors
from estimator.rig.rig import Rig
from estimator.store.session import Session

COVERAGE_DRAWS = 200
COVERAGE_READINGS = 20_000  # their 60,000 components tell a share of 90 % to 0.1 %
COVERAGE_ROWS = 1_000  # readings at once: departures of sensors hold dozens of numbers for each, by draw


def summary(
    session: Session,
    calibration: Calibration,
    next_degree_log_evidence: float | None = None,
    is_converged: bool = True,
) -> dict[str, Any]:
    """Whether it can be used, parameters with credible intervals, loop counts, errors, coverage and the origin of the readings.

    Args:
        session: Origin of the readings.
        calibration: Readings, draws and best values.
        next_degree_log_evidence, is_converged: See `assessment`.
    Returns: Numbers and words as JSON holds them; None stands for 'does not apply'.
    """
    rig, errors = calibration.rig, _errors(calibration)
    return {
        "quality": assessment(calibration, errors, next_degree_log_evidence, is_converged).to_json(),
        "parameters": _parameters(rig, calibration.draws),
        "prior_tension": _prior_tension(rig, calibration.draws),
        "loop_counts": _loop_counts(rig, calibration.draws),
        "best": dict(calibration.best),
        **errors,
        "session_hash": session.hash,
        "session_source": session.source,
        "session_created": session.created,
        "rig_hash": rig.hash,
        "rig_name": rig.name,
        "truth": dict(session.truth),
    }


def _parameters(rig: Rig, draws: Mapping[str, np.ndarray]) -> dict[str, Any]:
    result = {}
    for name, values in {**draws, **derived_numbers(rig, draws)}.items():
        diagnostics = convergence(values.T[:, :, None])
        lower, median, upper = np.quantile(values, [0.05, 0.5, 0.95])
        result[name] = {
            "median": float(median),
            "sd": float(values.std()),
            "ci90": [float(lower), float(upper)],
            "unit": rig.parameters[name].unit
            if name in rig.parameters
            else ("m" if name.endswith("_m") else "1"),
            "ess_bulk": finite(diagnostics.ess_bulk[0]),
            "ess_tail": finite(diagnostics.ess_tail[0]),
            "rhat": finite(diagnostics.rhat[0]),
            "is_derived": name not in draws,
        }
    return result


def _prior_tension(rig: Rig, draws: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Parameters whose median lies far from the centre of their prior, in its standard deviations: the prior or the model is wrong.

    A noise counts where it is too large: no missing physics makes a sensor quieter.
    """
    distance_sd = {
        p.name: p.prior.distance(float(np.median(draws[p.name]))) for p in rig.free if p.prior is not None
    }
    return {
        name: value
        for name, value in distance_sd.items()
        if (value if name.endswith(".noise_T") else abs(value)) > policy.TENSION_SD
    }


def derived_numbers(rig: Rig, draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Turns, length, thickness, and rms radius or sides of the mean loop, of every coil with a free winding: data determine these best."""
    derived = {}
    for coil in rig.wound:
        own = ("radius_m",) if isinstance(coil, Coil) else ("inner_side_x_m", "inner_side_y_m")
        if any(
            f"{coil.name}.{key}" in draws for key in (*own, "wire_radius_m", "axial_loops", "radial_loops")
        ):
            shape = next(iter(draws.values())).shape
            winding = {
                key: np.broadcast_to(_resolved(rig, f"{coil.name}.{key}", draws), shape)
                for key in (*own, "axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")
            }
            thickness = winding["radial_pitch_m"] * winding["radial_loops"]
            derived[f"{coil.name}.turns"] = winding["axial_loops"] * winding["radial_loops"]
            derived[f"{coil.name}.length_m"] = winding["axial_pitch_m"] * winding["axial_loops"]
            derived[f"{coil.name}.thickness_m"] = thickness
            if isinstance(coil, SidedCoil):
                for axis in "xy":
                    derived[f"{coil.name}.mean_side_{axis}_m"] = winding[f"inner_side_{axis}_m"] + thickness
                continue
            mean_radius = winding["radius_m"] - 0.5 * thickness
            # Variance of the radii of equally spaced layers, in squares of the pitch.
            variance = (winding["radial_loops"] ** 2 - 1.0) / 12.0
            derived[f"{coil.name}.rms_radius_m"] = np.sqrt(
                mean_radius**2 + winding["radial_pitch_m"] ** 2 * variance
            )
    return derived


def _resolved(rig: Rig, name: str, draws: Mapping[str, np.ndarray]) -> np.ndarray | float:
    if name in draws:
        return draws[name]
    parameter = rig.parameters[name]
    return (
        parameter.tie.factor * _resolved(rig, parameter.tie.to, draws) if parameter.tie else parameter.value
    )


def _loop_counts(rig: Rig, draws: Mapping[str, np.ndarray]) -> list[dict[str, Any]]:
    entries = []
    for coil in rig.wound:
        counts = [_resolved(rig, f"{coil.name}.{key}", draws) for key in ("axial_loops", "radial_loops")]
        is_free = any(isinstance(count, np.ndarray) for count in counts)
        if not is_free or not all((np.asarray(count) == np.round(count)).all() for count in counts):
            continue
        flat = [np.ravel(count) for count in np.broadcast_arrays(*counts)]
        pairs, n_draws = np.unique(np.stack(flat, axis=1), axis=0, return_counts=True)
        for i in np.argsort(-n_draws):
            axial, radial = (int(count) for count in pairs[i])
            entries.append(
                {
                    "coil": coil.name,
                    "axial": axial,
                    "radial": radial,
                    "probability": float(n_draws[i] / n_draws.sum()),
                }
            )
    return entries


def _errors(calibration: Calibration) -> dict[str, Any]:
    """Errors of the nominal and the calibrated model, by sensor too, and the coverage of the 90 % predictive interval."""
    nominal = nominal_tensors(calibration.rig)
    best = calibration.best_values()
    result: dict[str, Any] = {"rmse": {}, "rmse_nominal": {}, "rmse_by_sensor": {}, "coverage90": {}}
    for role, observations in (
        ("calibration", calibration.observations.calibration),
        ("validation", calibration.observations.validation),
    ):
        if not len(observations):
            result["rmse"][role] = result["rmse_nominal"][role] = result["coverage90"][role] = None
            continue
        model = MeasurementModel.for_values(calibration.rig, observations, best)
        measured, is_on = observations.field_sensor_T.numpy(), (observations.current_A != 0.0).any(-1).numpy()
        predicted = model.predict(best).expand(len(observations), 3).numpy()
        result["rmse"][role] = _error_sizes(error_metrics(measured, predicted, is_on))
        result["rmse_nominal"][role] = _error_sizes(
            error_metrics(measured, model.choose_rules(nominal).predict(nominal).numpy(), is_on)
        )
        result["rmse_by_sensor"][role] = {
            sensor.name: _error_sizes(error_metrics(measured[is_own], predicted[is_own], is_on[is_own]))
            for i, sensor in enumerate(calibration.rig.sensors)
            if (is_own := observations.sensor.numpy() == i).any()
        }
        result["coverage90"][role] = coverage90_of(calibration, model, observations)
    return result


def coverage90_of(calibration: Calibration, model: MeasurementModel, observations: Observations) -> float:
    """Share of measured components inside the central 90 % of the posterior predictive distribution, of some of many readings."""
    values, coordinates = calibration.draw_values(COVERAGE_DRAWS), Coordinates(calibration.rig, True)
    drawn = coordinates.vector({name: values[name] for name in coordinates.names})
    posterior = LogPosterior(coordinates, model, observations)
    numbers = torch.arange(len(observations))
    if len(observations) > COVERAGE_READINGS:
        generator = torch.Generator().manual_seed(0)
        numbers = torch.randperm(len(observations), generator=generator)[:COVERAGE_READINGS].sort().values
    inside = 0
    for part in numbers.split(COVERAGE_ROWS):
        of_part = posterior.part(part)
        with torch.no_grad():
            away = of_part.whitened(drawn)
            share, ratio = of_part.contamination(values)
        # Probability of less than was measured, over draws and noise.
        below = torch.lerp(torch.special.ndtr(away), torch.special.ndtr(away / ratio), share).mean(0)
        inside += int(((below >= 0.05) & (below <= 0.95)).sum())
    return inside / int(observations.is_measured[numbers].sum())


def _error_sizes(metrics: ErrorMetrics) -> dict[str, float | None]:
    return {name: finite(value) for name, value in asdict(metrics).items()}


def finite(value: float) -> float | None:
    """A finite number; None, for 'does not apply', in place of NaN and infinity, which JSON lacks."""
    return float(value) if np.isfinite(value) else None

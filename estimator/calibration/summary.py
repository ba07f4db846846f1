"""What a calibration found, as the plain values that become `summary.json` (docs/file-formats.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from estimator.calibration.result import Calibration
from estimator.inference.convergence import convergence
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.metrics import ErrorMetrics, error_metrics
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.session import Session

TENSION = 2.5  # standard deviations of the prior; one of ten honest parameters goes there in a tenth of the sessions
COVERAGE_DRAWS = 200
COVERAGE_ROWS = 10_000  # readings at once, to bound memory


def summary(session: Session, calibration: Calibration) -> dict[str, Any]:
    """Parameters with credible intervals, loop counts, errors, coverage and the origin of the readings.

    Args:
        session: Names the origin of the readings.
        calibration: Readings, draws and best values.
    Returns: What JSON can hold: None stands for 'does not apply'.
    """
    rig = calibration.rig
    return {
        "parameters": _parameters(rig, calibration.draws),
        "prior_tension": _prior_tension(rig, calibration.draws),
        "loop_counts": _loop_counts(rig, calibration.draws),
        "best": dict(calibration.best),
        **_errors(calibration),
        "session_hash": session.hash,
        "session_source": session.source,
        "session_created": session.created,
        "rig_hash": rig.hash,
        "rig_name": rig.name,
        "truth": dict(session.truth),
    }


def _parameters(rig: Rig, draws: Mapping[str, np.ndarray]) -> dict[str, Any]:
    every = {**draws, **_derived(rig, draws)}
    result = {}
    for name, values in every.items():
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
    """Parameters whose median lies far outside their prior, in its standard deviations: priors or model are wrong."""
    distance = {
        p.name: p.prior.distance(float(np.median(draws[p.name]))) for p in rig.free if p.prior is not None
    }
    return {name: value for name, value in distance.items() if abs(value) > TENSION}


def _derived(rig: Rig, draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Turns, length, thickness and rms radius of the loops of every coil whose winding is free: what the data determine best."""
    derived = {}
    for coil in rig.coils:
        if any(
            f"{coil.name}.{key}" in draws
            for key in ("radius_m", "wire_radius_m", "axial_loops", "radial_loops")
        ):
            shape = next(iter(draws.values())).shape
            get = {
                key: np.broadcast_to(_resolved(rig, f"{coil.name}.{key}", draws), shape)
                for key in ("radius_m", "axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")
            }
            thickness = get["radial_pitch_m"] * get["radial_loops"]
            derived[f"{coil.name}.turns"] = get["axial_loops"] * get["radial_loops"]
            derived[f"{coil.name}.length_m"] = get["axial_pitch_m"] * get["axial_loops"]
            derived[f"{coil.name}.thickness_m"] = thickness
            mean_radius, spread2 = get["radius_m"] - 0.5 * thickness, (get["radial_loops"] ** 2 - 1.0) / 12.0
            derived[f"{coil.name}.rms_radius_m"] = np.sqrt(
                mean_radius**2 + get["radial_pitch_m"] ** 2 * spread2
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
    table = []
    for coil in rig.coils:
        pair = [_resolved(rig, f"{coil.name}.{key}", draws) for key in ("axial_loops", "radial_loops")]
        is_free = any(isinstance(count, np.ndarray) for count in pair)
        if not is_free or not all((np.asarray(count) == np.round(count)).all() for count in pair):
            continue
        flat = [np.ravel(count) for count in np.broadcast_arrays(*pair)]
        pairs, number = np.unique(np.stack(flat, axis=1), axis=0, return_counts=True)
        for i in np.argsort(-number):
            axial, radial = (int(n) for n in pairs[i])
            table.append(
                {
                    "coil": coil.name,
                    "axial": axial,
                    "radial": radial,
                    "probability": float(number[i] / number.sum()),
                }
            )
    return table


def _errors(calibration: Calibration) -> dict[str, Any]:
    """Errors of nominal and calibrated model, per sensor too, and the coverage of the 90 % predictive interval."""
    nominal = {
        name: torch.tensor(v, dtype=torch.float64) for name, v in calibration.rig.nominal_values().items()
    }
    best = {name: torch.tensor(v, dtype=torch.float64) for name, v in calibration.best.items()}
    result: dict[str, Any] = {"rmse": {}, "rmse_nominal": {}, "rmse_by_sensor": {}, "coverage90": {}}
    for role, observations in (
        ("calibration", calibration.observations.calibration),
        ("validation", calibration.observations.validation),
    ):
        if not len(observations):
            result["rmse"][role] = result["rmse_nominal"][role] = result["coverage90"][role] = None
            continue
        model = MeasurementModel.build(calibration.rig, observations)
        measured = observations.field_sensor_T.numpy()
        predicted = model.predict(best).expand(len(observations), 3).numpy()
        result["rmse"][role] = _error_sizes(error_metrics(measured, predicted))
        result["rmse_nominal"][role] = _error_sizes(error_metrics(measured, model.predict(nominal).numpy()))
        result["rmse_by_sensor"][role] = {
            sensor.name: _error_sizes(error_metrics(measured[mine], predicted[mine]))
            for i, sensor in enumerate(calibration.rig.sensors)
            if (mine := observations.sensor.numpy() == i).any()
        }
        result["coverage90"][role] = _coverage(calibration, model, observations)
    return result


def _coverage(calibration: Calibration, model: MeasurementModel, observations: Observations) -> float:
    """Share of measured components inside the central 90 % of the posterior predictive distribution."""
    values = calibration.draw_values(COVERAGE_DRAWS)
    n_draws = min(COVERAGE_DRAWS, calibration.log_prob.size)
    noise_T = torch.stack(
        [values[f"{s.name}.noise_T"].expand(n_draws) for s in calibration.rig.sensors], dim=-1
    )
    with torch.no_grad():
        predicted = model.predict(values).expand(
            n_draws, len(observations), 3
        )  # no batch where only noise is free
    generator = torch.Generator().manual_seed(0)
    tails = torch.tensor([0.05, 0.95], dtype=torch.float64)
    inside = 0
    for part in torch.arange(len(observations)).split(COVERAGE_ROWS):
        sigma_T = noise_T[:, observations.sensor[part], None]
        noise = torch.randn(n_draws, len(part), 3, generator=generator, dtype=torch.float64)
        lower, upper = torch.quantile(predicted[:, part] + sigma_T * noise, tails, dim=0)
        measured = observations.field_sensor_T[part]
        inside += int(((measured >= lower) & (measured <= upper)).sum())
    return inside / int(observations.is_measured.sum())


def _error_sizes(metrics: ErrorMetrics) -> dict[str, float | None]:
    return {name: finite(value) for name, value in asdict(metrics).items()}


def finite(value: float) -> float | None:
    """JSON has no NaN and no infinity: None stands for 'does not apply'."""
    return float(value) if np.isfinite(value) else None

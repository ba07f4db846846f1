"""The page of one calibration: what was found, how well it fits, what the data leave open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure

from estimator import plots
from estimator.calibration import Calibration
from estimator.chain import Chain, base_from_motion, winding_of, world_from_body
from estimator.field.winding import Winding
from estimator.plots.style import shown, with_sd
from estimator.prediction import RoomField
from estimator.records import Observations
from estimator.report import Picture, ReportPage, Table, render_report
from estimator.rig import Coil
from estimator.units import split_unit

MOST_CORNER_PARAMETERS = 12
MOST_COILS = 3
PLANE_POINTS = 61
PLANE_DRAWS = 100


def calibration_report(calibration: Calibration, command: str) -> str:
    """HTML of one calibration, self-contained.

    Args:
        calibration: A calibration made by `estimator.calibrate` or loaded from disk.
        command: What produced it, shown as provenance.
    """
    record = calibration.record
    title = f"{calibration.rig.name}, {record['session_created'][:10]}"
    page = ReportPage(
        title=f"Calibration of {calibration.rig.name}",
        subtitle=f"{record['session_source']}; readings recorded {record['session_created']}",
        verdict=_verdict(record, calibration.observations),
        warnings=_warnings(record),
        tables=_tables(calibration),
        figures=list(_figures(calibration, title)),
        provenance={
            "command": command,
            "seed": str(record["seed"]),
            "session": record["session_hash"],
            "rig": record["rig_hash"],
            "versions": ", ".join(f"{name} {v}" for name, v in record["versions"].items()),
            "sampling": _sampling(record),
        },
    )
    return render_report(page)


def _verdict(record: Mapping[str, Any], observations: Observations) -> list[str]:
    role = "validation" if record["rmse"]["validation"] else "calibration"
    error, nominal = record["rmse"][role], record["rmse_nominal"][role]
    kept = (
        "readings kept out of the fit"
        if role == "validation"
        else "readings of the fit itself (none were kept out)"
    )
    sentences = [
        f"The calibrated model is off by {_microtesla(error['vector_T'])} rms ({error['relative']:.2%} of the field) on "
        f"{kept}; before calibration it was off by {_microtesla(nominal['vector_T'])} ({nominal['relative']:.2%}).",
        f"Its 90 % intervals hold {record['coverage90'][role]:.1%} of the components of these readings.",
    ]
    for entry in _most_probable(record["loop_counts"]):
        sentences.append(
            f"{entry['coil']} has {entry['axial']} x {entry['radial']} loops with probability {entry['probability']:.2f}."
        )
    n_fit = len(observations.calibration)
    sentences.append(f"{n_fit} readings determined {len(record['point_estimate']['values'])} parameters.")
    return sentences


def _warnings(record: Mapping[str, Any]) -> list[str]:
    found = []
    if not record["is_converged"]:
        found.append(f"Sampling did not converge: {_sampling(record)}. The intervals are provisional.")
    for direction in record["undetermined"]:
        found.append(
            f"The data do not determine {direction['words']}: their own standard deviation is "
            f"{min(direction['data_over_prior_sd'], 9999):.3g} times the prior's, so the interval is the prior's."
        )
    estimate = record["point_estimate"]
    if estimate["starts_agreeing"] < 0.5 * estimate["starts"]:
        found.append(
            f"Only {estimate['starts_agreeing']} of {estimate['starts']} starts found the best maximum: there may be several."
        )
    return found


def _tables(calibration: Calibration) -> list[Table]:
    record = calibration.record
    names = list(record["parameters"])
    display = shown(names)
    truth = record["truth"]
    header = [
        "parameter",
        "median ± sd",
        "90 % credible interval",
        "unit",
        "prior",
        *(["truth"] if truth else []),
    ]
    rows = []
    for name in names:
        p, factor = record["parameters"][name], display[name].factor
        parameter = calibration.rig.parameters.get(name)
        prior = parameter.prior if parameter is not None else None
        row = [
            split_unit(name)[0],
            with_sd(p["median"] * factor, p["sd"] * factor),
            f"{p['ci90'][0] * factor:.6g} to {p['ci90'][1] * factor:.6g}",
            display[name].unit or "1",
            with_sd(prior.centre * factor, prior.sd * factor) if prior else "derived",
        ]
        rows.append(row + ([f"{truth[name] * factor:.6g}" if name in truth else "—"] if truth else []))
    tables = [Table("Parameters", header, rows, "Medians and central 90 % intervals of the posterior.")]
    if record["loop_counts"]:
        counts = [
            [e["coil"], str(e["axial"]), str(e["radial"]), f"{e['probability']:.4f}"]
            for e in record["loop_counts"][:10]
        ]
        tables.append(Table("Loop counts", ["coil", "axial", "radial", "probability"], counts))
    tables.append(_error_table(record))
    if len(calibration.rig.sensors) > 1:
        tables.append(_sensor_table(record))
    return tables


def _error_table(record: Mapping[str, Any]) -> Table:
    rows = []
    for role in ("calibration", "validation"):
        for label, source in (("nominal", "rmse_nominal"), ("calibrated", "rmse")):
            m = record[source][role]
            if m is None:
                continue
            angle = m["angular_deviation_rad"]
            rows.append(
                [
                    f"{label}, {role}",
                    _microtesla(m["vector_T"]),
                    _microtesla(m["component_T"]),
                    _microtesla(m["paper_metric_T"]),
                    _microtesla(m["max_T"]),
                    f"{m['relative']:.3%}",
                    f"{np.degrees(angle):.3f}°" if angle is not None else "—",
                ]
            )
    header = [
        "model and readings",
        "vector rms",
        "component rms",
        "paper's metric",
        "largest",
        "of rms field",
        "mean angle",
    ]
    return Table("Errors", header, rows, "The paper's metric is half the vector rms.")


def _sensor_table(record: Mapping[str, Any]) -> Table:
    rows = [
        [name, _microtesla(m["vector_T"]), f"{m['relative']:.3%}"]
        for name, m in record["rmse_by_sensor"]["calibration"].items()
    ]
    return Table("Errors by sensor", ["sensor", "vector rms", "of rms field"], rows)


def _figures(calibration: Calibration, title: str) -> Iterator[Picture]:
    observations = calibration.observations.calibration
    best = {name: torch.tensor(value, dtype=torch.float64) for name, value in calibration.best.items()}
    chain = Chain.build(calibration.rig, observations)
    measured_T = observations.field_sensor_T.numpy()
    predicted_T = chain.predict(best).numpy()
    residual_T = measured_T - predicted_T
    sensor = observations.sensor.numpy()
    by_sensor_T = np.array([calibration.best[f"{s.name}.noise_T"] for s in calibration.rig.sensors])
    sigma_T = (
        float(by_sensor_T[0]) if len(by_sensor_T) == 1 else by_sensor_T[sensor][:, None].repeat(3, axis=1)
    )

    yield Picture(
        "Predicted against measured",
        "Points should lie on the line, and residuals inside the band without a trend.",
        _figure(plots.predicted_against_measured(measured_T, predicted_T, sigma_T, title=title)),
    )
    yield Picture(
        "Whitened residuals",
        "If the model is complete the histogram follows the normal curve.",
        _figure(plots.residual_histogram(residual_T, sigma_T, title=title)),
    )
    if len(by_sensor_T) > 1:
        names = [s.name for s in calibration.rig.sensors]
        yield Picture(
            "Residuals by sensor",
            "A sensor that stands out has a fault of its own.",
            _figure(plots.residual_by_sensor(residual_T, sensor, names, sigma_T, title=title)),
        )
    for coil, positions_m, winding in _places(calibration, chain, best):
        yield from _maps(coil, positions_m, winding, measured_T, predicted_T, sigma_T, title)
        yield from _plane(calibration, coil, positions_m, best, winding, title)
    yield from _posterior_figures(calibration, title)


def _maps(
    coil: Coil,
    positions_m: np.ndarray,
    winding: Winding,
    measured_T: np.ndarray,
    predicted_T: np.ndarray,
    sigma_T: float | np.ndarray,
    title: str,
) -> Iterator[Picture]:
    here = np.isfinite(positions_m).all(axis=1)
    places, measured, predicted = positions_m[here], measured_T[here], predicted_T[here]
    one_sigma = sigma_T if isinstance(sigma_T, float) else None
    yield Picture(
        f"Residual around {coil.name}",
        "Length of the residual where the sensor stood, in the coil's frame; patterns point to something the model lacks.",
        plots.residual_map(places, measured - predicted, winding, sigma_T=one_sigma, title=title),
    )
    yield Picture(
        f"Relative error around {coil.name}",
        "Residual over measured field; it grows where the field is weak.",
        plots.relative_error_map(places, measured, predicted, winding, title=title),
    )
    if np.isfinite(measured).all(axis=1).any():
        yield Picture(
            f"Angular deviation around {coil.name}",
            "Angle between measured and predicted field.",
            plots.angular_deviation_map(places, measured, predicted, winding, title=title),
        )


def _posterior_figures(calibration: Calibration, title: str) -> Iterator[Picture]:
    draws = {name: array.reshape(-1) for name, array in calibration.draws.items()}
    moving = [name for name, values in draws.items() if np.ptp(values) > 0.0][:MOST_CORNER_PARAMETERS]
    truth = {
        name: calibration.record["truth"][name] for name in moving if name in calibration.record["truth"]
    }
    priors = {p.name: p.prior for p in calibration.rig.free if p.prior is not None}
    yield Picture(
        "What the data taught",
        "Posterior interval of every parameter in units of its prior: narrow means determined by the data.",
        _figure(plots.interval_summary(draws, priors, calibration.record["truth"] or None, title=title)),
    )
    if len(moving) > 1:
        point = {name: calibration.best[name] for name in moving}
        yield Picture(
            "Posterior",
            "68 and 95 % regions; narrow diagonal bands are combinations that the data determine better than single parameters.",
            plots.corner({name: draws[name] for name in moving}, truth or None, point, title=title),
        )
    yield Picture(
        "Trace",
        "Walkers should mix and not drift.",
        plots.traces({name: calibration.draws[name].T for name in moving or list(draws)[:1]}, title=title),
    )


def _places(
    calibration: Calibration, chain: Chain, best: Mapping[str, torch.Tensor]
) -> Iterator[tuple[Coil, np.ndarray, Winding]]:
    """Per coil that carried current the sensor's position in its frame for every reading; NaN where it was off."""
    for coil in calibration.rig.coils[:MOST_COILS]:
        rows = chain.powered[coil.name]
        if not len(rows):
            continue
        points, _ = chain.sensor_in_coil(coil, rows, best)
        everywhere = np.full((len(chain.sensor), 3), np.nan)
        everywhere[rows.numpy()] = points.numpy()
        yield coil, everywhere[chain.place.numpy()], winding_of(coil, best)


def _plane(
    calibration: Calibration,
    coil: Coil,
    positions_m: np.ndarray,
    best: Mapping[str, torch.Tensor],
    winding: Winding,
    title: str,
) -> Iterator[Picture]:
    """Field of one ampere in the XZ plane of the coil, with the relative half-width of its 90 % interval."""
    reach = 1.2 * max(float(winding.radius_m), np.nanmax(np.abs(positions_m[:, :2])))
    low = min(-1.3 * float(winding.length_m), 1.1 * np.nanmin(positions_m[:, 2]))
    high = max(0.5 * float(winding.radius_m), 1.1 * np.nanmax(positions_m[:, 2]))
    x_m, z_m = np.linspace(-reach, reach, PLANE_POINTS), np.linspace(low, high, PLANE_POINTS)
    grid = np.stack(np.meshgrid(x_m, [0.0], z_m, indexing="ij"), axis=-1)[:, 0].transpose(1, 0, 2)
    points_m = torch.from_numpy(grid.reshape(-1, 3))
    field, half_width = _field_in_coil_frame(calibration, coil, best, points_m)
    shape = (PLANE_POINTS, PLANE_POINTS)
    yield Picture(
        f"Field of {coil.name}",
        "Field per ampere in the plane through the axis, and how uncertain it is: the model is known where readings were taken.",
        plots.field_plane(
            x_m,
            z_m,
            field.reshape(*shape, 3),
            half_width.reshape(shape),
            winding,
            readings_m=positions_m,
            title=title,
        ),
    )


def _field_in_coil_frame(
    calibration: Calibration, coil: Coil, best: Mapping[str, torch.Tensor], points_m: torch.Tensor
) -> tuple[np.ndarray, np.ndarray]:
    """Field per ampere around the coil, in its frame, and the relative half-width of the 90 % interval of its strength."""
    rig = calibration.rig
    flange = {
        mover.name: base_from_motion(mover, torch.zeros(1, 6, dtype=torch.float64)) for mover in rig.movers
    }
    world_from_coil = world_from_body(rig, coil, "coil", flange, best)
    room = RoomField(rig, best, world_from_coil.apply(points_m))
    current_A = torch.tensor([float(other is coil) for other in rig.coils], dtype=torch.float64)
    field = room.field_T(best, current_A)
    strength = room.field_T(calibration.draw_values(PLANE_DRAWS), current_A).norm(dim=-1)
    lower, upper = torch.quantile(strength, torch.tensor([0.05, 0.95], dtype=torch.float64), dim=0)
    half_width = 0.5 * (upper - lower) / field.norm(dim=-1)
    return world_from_coil.unrotate(field).numpy(), half_width.numpy()


def _figure(axes: Any) -> Figure:
    figure: Figure = axes.figure
    return figure


def _most_probable(loop_counts: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    first: dict[str, Mapping[str, Any]] = {}
    for entry in loop_counts:
        first.setdefault(entry["coil"], entry)
    return list(first.values())


def _sampling(record: Mapping[str, Any]) -> str:
    s = record["sampling"]
    rhat = f"{s['largest_rhat']:.4f}" if s["largest_rhat"] is not None else "none"
    return (
        f"{s['steps']} steps of {s['walkers']} walkers, acceptance {s['acceptance']:.2f}, "
        f"smallest effective sample size {s['smallest_ess']:.0f}, largest R-hat {rhat}"
    )


def _microtesla(value_T: float) -> str:
    return f"{value_T * 1e6:.4g} µT"

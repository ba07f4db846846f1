"""The figures of one calibration: fit, residuals around each coil, field and posterior.

Fields are computed here, pictures are drawn by the page.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import islice
from typing import NamedTuple

import numpy as np
import torch
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt

from estimator.calibration.result import Calibration
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.model.bodies import winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField, at_one_moment, some_at_a_time
from estimator.reporting import plots
from estimator.reporting.page import Picture
from estimator.rig.bodies import AnyCoil, Coil, HarmonicCoil

MOST_CORNER_PARAMETERS = 12
MOST_INTERVALS = 60
MOST_COILS = 3
PLANE_POINTS = 61
PLANE_DRAWS = 100


def pictures(calibration: Calibration) -> list[Picture]:
    """The figures of the report, each with a title and a sentence on what to look for."""
    title = f"{calibration.rig.name}, {calibration.summary()['session_created'][:10]}"
    return [*_fit_figures(calibration, title), *_posterior_figures(calibration, title)]


class Fitted(NamedTuple):
    """The readings of a fit beside the calibrated model.

    Attributes:
        model: Of these readings.
        best: Values of the rig.
        measured_T, predicted_T: Components of each reading, NaN where they were not measured.
        sigma_T: Noise, of all or of each component.
    """

    model: MeasurementModel
    best: dict[str, torch.Tensor]
    measured_T: np.ndarray
    predicted_T: np.ndarray
    sigma_T: float | np.ndarray

    @property
    def residual_T(self) -> np.ndarray:
        """What the model misses."""
        missed_T: np.ndarray = self.measured_T - self.predicted_T
        return missed_T


def fitted(calibration: Calibration) -> Fitted:
    """The readings of a calibration beside its model."""
    observations, best = calibration.observations.calibration, calibration.best_values()
    model = MeasurementModel.build(calibration.rig, observations)
    by_sensor_T = np.array([calibration.best[f"{s.name}.noise_T"] for s in calibration.rig.sensors])
    each_T = by_sensor_T[observations.sensor.numpy()][:, None].repeat(3, axis=1)
    sigma_T = float(by_sensor_T[0]) if len(by_sensor_T) == 1 else each_T
    return Fitted(model, best, observations.field_sensor_T.numpy(), model.predict(best).numpy(), sigma_T)


def field_picture(calibration: Calibration, coil: str) -> Picture | None:
    """The field of a coil in the plane through its axis, with its uncertainty; None where it carried no current."""
    fit = fitted(calibration)
    for own, positions_m, winding in _sensor_positions(calibration, fit.model, fit.best):
        if own.name == coil:
            return _plane(_coil_plane(calibration, own, positions_m, fit.best, winding), calibration.rig.name)
    return None


def _fit_figures(calibration: Calibration, title: str) -> Iterator[Picture]:
    fit = fitted(calibration)
    model, best, measured_T, predicted_T, sigma_T = fit
    residual_T, sensor = fit.residual_T, calibration.observations.calibration.sensor.numpy()

    yield Picture(
        "Predicted against measured",
        "Points should lie on the line. About two residuals in three should lie inside the band (one standard deviation), without a trend.",
        partial(plots.predicted_against_measured, measured_T, predicted_T, sigma_T, title=title),
    )
    yield Picture(
        "Whitened residuals",
        "If the model is complete the histogram follows the normal curve.",
        partial(plots.residual_histogram, residual_T, sigma_T, title=title),
    )
    if len(calibration.rig.sensors) > 1:
        names = [s.name for s in calibration.rig.sensors]
        yield Picture(
            "Residuals by sensor",
            "A sensor or component that stands out has a fault; if the noise was fitted, the components of a sensor average to 1.",
            partial(plots.residual_by_sensor, residual_T, sensor, names, sigma_T, title=title),
        )
    for coil, positions_m, winding in islice(_sensor_positions(calibration, model, best), MOST_COILS):
        yield from _maps(coil, positions_m, winding, measured_T, predicted_T, sigma_T, title)
        yield _plane(_coil_plane(calibration, coil, positions_m, best, winding), title)


def _maps(
    coil: AnyCoil,
    positions_m: np.ndarray,
    winding: Winding | None,
    measured_T: np.ndarray,
    predicted_T: np.ndarray,
    sigma_T: float | np.ndarray,
    title: str,
) -> Iterator[Picture]:
    has_current = np.isfinite(positions_m).all(axis=1)
    shown_m, measured, predicted = positions_m[has_current], measured_T[has_current], predicted_T[has_current]
    one_sigma = sigma_T if isinstance(sigma_T, float) else None
    yield Picture(
        f"Residual around {coil.name}",
        "Length of the residual where the sensor stood, in the coil's frame; a pattern points to something the model lacks.",
        partial(plots.residual_map, shown_m, measured - predicted, winding, sigma_T=one_sigma, title=title),
    )
    yield Picture(
        f"Relative error around {coil.name}",
        "Residual over measured field; it grows where the field is weak.",
        partial(plots.relative_error_map, shown_m, measured, predicted, winding, title=title),
    )
    if np.isfinite(measured).all(axis=1).any():
        yield Picture(
            f"Angular deviation around {coil.name}",
            "Angle between measured and predicted field.",
            partial(plots.angular_deviation_map, shown_m, measured, predicted, winding, title=title),
        )


def _posterior_figures(calibration: Calibration, title: str) -> Iterator[Picture]:
    yield from _spectra(calibration, title)
    amplitudes = {
        name for coil in calibration.rig.unwound for own in coil.amplitudes.values() for name in own
    }
    in_file = list(calibration.rig.parameters)
    names = sorted(calibration.draws.keys() - amplitudes, key=in_file.index)
    if not names:
        return
    draws = {name: calibration.draws[name].reshape(-1) for name in names}
    moving = [name for name in names if np.ptp(draws[name]) > 0.0][:MOST_CORNER_PARAMETERS]
    truth = {
        name: calibration.summary()["truth"][name]
        for name in moving
        if name in calibration.summary()["truth"]
    }
    priors = {p.name: p.prior for p in calibration.rig.free if p.prior is not None}
    shown = {name: draws[name] for name in names[:MOST_INTERVALS]}
    which = (
        "every parameter"
        if len(shown) == len(names)
        else f"the first {len(shown)} of {len(names)} parameters"
    )
    yield Picture(
        "What the data taught",
        f"Posterior interval of {which} in units of its prior; a narrow one is determined by the data.",
        partial(plots.interval_summary, shown, priors, calibration.summary()["truth"] or None, title=title),
    )
    if len(moving) > 1:
        point = {name: calibration.best[name] for name in moving}
        yield Picture(
            "Posterior",
            "68 and 95 % regions; narrow diagonal bands are combinations that the data determine better than single parameters.",
            partial(plots.corner, {name: draws[name] for name in moving}, truth or None, point, title=title),
        )
    yield Picture(
        "Trace",
        "Walkers should mix and not drift.",
        partial(
            plots.traces, {name: calibration.draws[name].T for name in moving or list(draws)[:1]}, title=title
        ),
    )


def _spectra(calibration: Calibration, title: str) -> Iterator[Picture]:
    """Spectrum of the amplitudes of each harmonic coil of which the readings determine any."""
    determined = calibration.summary().get("amplitudes", {})
    for coil in calibration.rig.unwound:
        if not isinstance(coil, HarmonicCoil) or not determined.get(coil.name, {}).get("determined"):
            continue
        free = {
            degree: drawn
            for degree, names in coil.amplitudes.items()
            if (drawn := [name for name in names if name in calibration.draws])
        }
        medians = {
            degree: np.array([np.median(calibration.draws[name]) for name in names])
            for degree, names in free.items()
        }
        sds = {
            degree: np.array([calibration.draws[name].std() for name in names])
            for degree, names in free.items()
        }
        priors = {degree: calibration.rig.parameters[names[0]].prior for degree, names in free.items()}
        prior_sd = {degree: prior.sd for degree, prior in priors.items() if prior is not None}
        yield Picture(
            f"Harmonics of {coil.name}",
            "Points far above the band are known; where they sink into it, readings tell no more. If the last stand out, raise `degree`.",
            partial(plots.harmonic_spectrum, medians, sds, prior_sd, title=title),
        )


def _sensor_positions(
    calibration: Calibration, model: MeasurementModel, best: Mapping[str, torch.Tensor]
) -> Iterator[tuple[AnyCoil, np.ndarray, Winding | None]]:
    """Position of the sensor in the frame of each coil that carried current, reading by reading; NaN while the coil was off."""
    for coil in calibration.rig.coils:
        rows = model.powered[coil.name]
        if not len(rows):
            continue
        points, _ = model.sensor_in_coil(coil, rows, best)
        everywhere = np.full((len(model.sensor), 3), np.nan)
        everywhere[rows.numpy()] = points.numpy()
        winding = winding_of(calibration.rig, coil, best) if isinstance(coil, Coil) else None
        yield coil, everywhere[model.pose_row.numpy()], winding


class CoilPlane(NamedTuple):
    """Field of one ampere in the plane y = 0 of a coil's frame.

    Attributes:
        coil: Its name.
        x_m, z_m: Coordinates, evenly spaced.
        field_T_per_A: Vectors in the coil's frame, by z and x.
        relative: Half-width of the 90 % interval of the size of the field, over the size.
        positions_m: Places of the sensor.
        winding: Of the coil; None where it is not known.
    """

    coil: str
    x_m: np.ndarray
    z_m: np.ndarray
    field_T_per_A: np.ndarray
    relative: np.ndarray
    positions_m: np.ndarray
    winding: Winding | None


def coil_planes(calibration: Calibration, n_points: int = PLANE_POINTS) -> Iterator[CoilPlane]:
    """The field of each coil that carried current, of the first few where there are many; without that of the room."""
    fit, alone = fitted(calibration), calibration.coils_alone()
    for coil, positions_m, winding in islice(_sensor_positions(calibration, fit.model, fit.best), MOST_COILS):
        yield _coil_plane(alone, coil, positions_m, fit.best, winding, n_points)


def _coil_plane(
    calibration: Calibration,
    coil: AnyCoil,
    positions_m: np.ndarray,
    best: Mapping[str, torch.Tensor],
    winding: Winding | None,
    n_points: int = PLANE_POINTS,
) -> CoilPlane:
    """The field around a coil, as far as its readings reach.

    The plane is at most twice as high as wide: beyond that the field is a dipole's and panels get thin.
    """
    reach = 1.2 * np.nanmax(np.abs(positions_m[:, :2]))
    if winding is None:
        reach = max(reach, 1.2 * float(np.nanmax(np.abs(positions_m))))
        low, high = -reach, reach
    else:
        radius_m, length_m = float(winding.radius_m), float(winding.length_m)
        reach = max(reach, 1.2 * radius_m)
        low = min(-1.3 * length_m, max(1.1 * np.nanmin(positions_m[:, 2]), -0.5 * length_m - 2.0 * reach))
        high = max(0.5 * radius_m, min(1.1 * np.nanmax(positions_m[:, 2]), 2.0 * reach))
    x_m, z_m = np.linspace(-reach, reach, n_points), np.linspace(low, high, n_points)
    field = _field_per_A(calibration, coil, best, _grid(x_m, z_m))
    # Half as fine, for it is smooth: draws of an effect that sums over all loops would take minutes.
    coarse_x_m, coarse_z_m = (np.linspace(at[0], at[-1], n_points // 2 + 1) for at in (x_m, z_m))
    coarse = _relative_half_width(calibration, coil, best, _grid(coarse_x_m, coarse_z_m))
    coarse = coarse.reshape(len(coarse_z_m), -1)
    nearest = distance_transform_edt(~np.isfinite(coarse), return_distances=False, return_indices=True)
    between = RegularGridInterpolator((coarse_z_m, coarse_x_m), coarse[tuple(nearest)])
    half_width = between(np.stack(np.meshgrid(z_m, x_m, indexing="ij"), axis=-1))
    half_width[~np.isfinite(field).all(-1).reshape(n_points, n_points)] = np.nan  # inside the winding
    return CoilPlane(
        coil.name, x_m, z_m, field.reshape(n_points, n_points, 3), half_width, positions_m, winding
    )


def _grid(x_m: np.ndarray, z_m: np.ndarray) -> torch.Tensor:
    """Points of the plane y = 0, row by row of z."""
    z, x = np.meshgrid(z_m, x_m, indexing="ij")
    return torch.from_numpy(np.stack((x, np.zeros_like(x), z), axis=-1).reshape(-1, 3))


def _plane(plane: CoilPlane, title: str) -> Picture:
    """The plane as a picture."""
    return Picture(
        f"Field of {plane.coil}",
        "Field per ampere in the plane through the axis, and its uncertainty: the model is known best where readings were taken.",
        partial(
            plots.field_plane,
            plane.x_m,
            plane.z_m,
            plane.field_T_per_A,
            plane.relative,
            plane.winding,
            readings_m=plane.positions_m,
            title=title,
        ),
    )


def _field_per_A(
    calibration: Calibration, coil: AnyCoil, best: Mapping[str, torch.Tensor], points_m: torch.Tensor
) -> np.ndarray:
    """Field per ampere around the coil, in its frame."""
    world_from_coil, room, current_A = _around(calibration, coil, best, points_m)
    return world_from_coil.unrotate(room.field_T(best, current_A)).numpy()


def _relative_half_width(
    calibration: Calibration, coil: AnyCoil, best: Mapping[str, torch.Tensor], points_m: torch.Tensor
) -> np.ndarray:
    """Half-width of the 90 % interval of the magnitude of that field, relative to it."""
    _, room, current_A = _around(calibration, coil, best, points_m)
    strength = some_at_a_time(
        lambda values: room.field_T(values, current_A).norm(dim=-1),
        calibration.draw_values(PLANE_DRAWS),
        len(points_m),
        1,
    )
    ends = torch.tensor([0.05, 0.95], dtype=torch.float64)
    lower, upper = torch.quantile(torch.atleast_2d(strength), ends, dim=0)
    half_width: np.ndarray = (0.5 * (upper - lower) / room.field_T(best, current_A).norm(dim=-1)).numpy()
    return half_width


def _around(
    calibration: Calibration, coil: AnyCoil, best: Mapping[str, torch.Tensor], points_m: torch.Tensor
) -> tuple[Transform, RoomField, torch.Tensor]:
    """The frame of a coil, the field at points in it, and one ampere in that coil alone."""
    rig = calibration.rig
    world_from_coil = at_one_moment(rig).world_from_body(coil, "coil", torch.arange(1), best)
    current_A = torch.tensor([float(powered is coil) for powered in rig.coils], dtype=torch.float64)
    return world_from_coil, RoomField(rig, best, world_from_coil.apply(points_m)), current_A

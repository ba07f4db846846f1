"""The figures of one calibration: fit, residuals around each coil, field and posterior.

Pictures are drawn by the page.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import islice

import numpy as np

from estimator.calibration.fitted import fitted, sensor_positions
from estimator.calibration.planes import MOST_COILS, CoilPlane, coil_plane
from estimator.calibration.result import Calibration
from estimator.field.winding import Winding
from estimator.reporting import plots
from estimator.reporting.page import Picture
from estimator.rig.bodies import AnyCoil

MOST_CORNER_PARAMETERS = 12
MOST_INTERVALS = 60


def pictures(calibration: Calibration) -> list[Picture]:
    """The figures of the report, each with a title and a sentence on what to look for."""
    title = f"{calibration.rig.name}, {calibration.summary()['session_created'][:10]}"
    return [*_fit_figures(calibration, title), *_posterior_figures(calibration, title)]


def field_picture(calibration: Calibration, coil: str) -> Picture | None:
    """The field of a coil in the plane through its axis, with its uncertainty; None where it carried no current."""
    fit = fitted(calibration)
    for own, positions_m, winding in sensor_positions(calibration, fit):
        if own.name == coil:
            return _plane(coil_plane(calibration, own, positions_m, fit.best, winding), calibration.rig.name)
    return None


def _fit_figures(calibration: Calibration, title: str) -> Iterator[Picture]:
    fit = fitted(calibration)
    measured_T, predicted_T, sigma_T = fit.measured_T, fit.predicted_T, fit.sigma_T
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
    for coil, positions_m, winding in islice(sensor_positions(calibration, fit), MOST_COILS):
        yield from _maps(coil, positions_m, winding, measured_T, predicted_T, sigma_T, title)
        yield _plane(coil_plane(calibration, coil, positions_m, fit.best, winding), title)


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
        if not coil.has_degrees or not determined.get(coil.name, {}).get("determined"):
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

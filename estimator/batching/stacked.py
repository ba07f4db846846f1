"""Fits many sessions at once on the batch axis: the same rig at the same settings with different readings.

A fit of a few hundred readings spends most of its time launching tensor operations; a stack of sessions launches them once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from estimator.devices import device_named, precision_named
from estimator.effects import effect_of
from estimator.effects.circumstances import Circumstances
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.arrays import digest, observation_arrays

TOLERANCE = 1e-4  # in log density
FIRST_ITERATIONS = 12  # from every start, before only the highest one continues


def settings_hash(rig: Rig, observations: Observations) -> str:
    """SHA-256 of everything that a prediction needs: sessions that share it can be stacked.

    It covers which components were measured but not their values, nor measured currents, which no prediction uses. Times and temperatures
    count only if the rig has effects that may depend on them.
    """
    arrays = observation_arrays(observations)
    dimensions, _ = arrays.pop("field_sensor_T")
    arrays["is_measured"] = dimensions, observations.is_measured.numpy()
    is_steady = all(effect_of(cause.name).is_everywhere for cause in rig.acting)
    ignored = ("repeat", "current_measured_A", *(("time_s", "temperature_") if is_steady else ()))
    return digest(
        {name: array for name, array in arrays.items() if not name.startswith(ignored)}, {"rig": rig.hash}
    )


def stacked_fits(
    rig: Rig,
    sessions: Sequence[Observations],
    seeds: Sequence[int],
    more_starts: int,
    device: str | None = None,
    precision: str | None = None,
) -> list[tuple[LogPosterior, Optimum]]:
    """The maximum of the posterior of each session, by Levenberg-Marquardt from the nominal values and from draws of the prior.

    All starts take some iterations, then the highest of each session continues to convergence.

    Args:
        rig: Rig of all sessions; free loop counts are real numbers.
        sessions: Readings to fit, all with the same `settings_hash`.
        seeds: Seed of the draws of each session, so that a result does not depend on its stack.
        more_starts: Number of draws of the prior beside the nominal values.
        device, precision: Where and how precisely the fits climb; by default as the readings. Their last step is always made where the
            readings are, in their precision.
    Returns: The log posterior of each session and its highest maximum.
    """
    home, posteriors = _stacked(rig, sessions)
    place = sessions[0].device if device is None else device_named(device)
    dtype = sessions[0].dtype if precision is None else precision_named(precision)
    is_home = (place, dtype) == (sessions[0].device, sessions[0].dtype)
    stacked = home if is_home else _stacked(rig, [session.to(place, dtype) for session in sessions])[0]
    n_starts = 1 + more_starts
    each = torch.arange(len(sessions), device=place).repeat_interleave(n_starts)
    starts = torch.cat([_starts(stacked.coordinates, seed, more_starts) for seed in seeds])
    is_possible = torch.isfinite(stacked.at(each)(starts))
    starts = torch.where(is_possible[:, None], starts, stacked.coordinates.start())
    first = levenberg_marquardt(stacked.at(each), starts, FIRST_ITERATIONS, TOLERANCE)
    highest = first.log_posterior.reshape(len(sessions), n_starts).argmax(1)
    highest = highest + n_starts * torch.arange(len(sessions), device=place)
    reached = first.vector[highest]
    if not is_home:
        reached = levenberg_marquardt(stacked, reached, tolerance=TOLERANCE).vector.to(sessions[0].device)
    fits = levenberg_marquardt(home, reached, tolerance=TOLERANCE)
    return [(posterior, fits.rows(slice(i, i + 1))) for i, posterior in enumerate(posteriors)]


def _stacked(rig: Rig, sessions: Sequence[Observations]) -> tuple[LogPosterior, list[LogPosterior]]:
    """The density whose rows have the readings of one session each, and those of the sessions."""
    model = MeasurementModel.build(rig, sessions[0])
    coordinates = Coordinates(rig).on(sessions[0].device)
    posteriors = [
        LogPosterior(coordinates, model.with_circumstances(Circumstances(rig, observations)), observations)
        for observations in sessions
    ]
    return posteriors[0].with_rows(torch.stack([p.measured_T for p in posteriors])), posteriors


def _starts(coordinates: Coordinates, seed: int, more: int) -> torch.Tensor:
    nominal = coordinates.start()[None]
    return (
        torch.cat((nominal, coordinates.sample_prior(np.random.default_rng(seed), more))) if more else nominal
    )

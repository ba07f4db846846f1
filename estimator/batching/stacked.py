"""Many sessions fitted at once on the batch axis: the same rig at the same settings, with readings of their own.

A fit of a few hundred readings spends its time in starting tensor operations, not in them; a stack of sessions starts them once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from estimator.effects.circumstances import Circumstances
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.session import digest, observation_arrays

TOLERANCE = 1e-4  # in log density
FIRST_ITERATIONS = 12  # from every start, before the highest one climbs on


def settings_hash(rig: Rig, observations: Observations) -> str:
    """SHA-256 of all that a prediction needs: sessions that share it can be stacked.

    The readings themselves are no part of it, only which of their components were measured; nor are measured currents, which no prediction
    uses. Times and temperatures are where the rig has effects, which may depend on them.
    """
    arrays = observation_arrays(observations)
    dimensions, _ = arrays.pop("field_sensor_T")
    arrays["is_measured"] = dimensions, observations.is_measured.numpy()
    ignored = ("repeat", "current_measured_A", *(() if rig.effects else ("time_s", "temperature_")))
    return digest(
        {name: array for name, array in arrays.items() if not name.startswith(ignored)}, {"rig": rig.hash}
    )


def stacked_fits(
    rig: Rig, sessions: Sequence[Observations], seeds: Sequence[int], more_starts: int
) -> list[tuple[LogPosterior, Optimum]]:
    """The maximum of the posterior of each session, by Levenberg-Marquardt from the nominal values and from draws of the prior.

    All starts climb some steps, then the highest of each session climbs to its top.

    Args:
        rig: Of all of them; free loop counts are real numbers.
        sessions: Readings to fit, all of the same `settings_hash`.
        seeds: Of the draws, session by session, so that a result does not depend on what it was stacked with.
        more_starts: Draws of the prior beside the nominal values.
    Returns: Per session its own density and the highest maximum found.
    """
    model = MeasurementModel.build(rig, sessions[0])
    coordinates = Coordinates(rig)
    own = [
        LogPosterior(coordinates, model.with_circumstances(Circumstances(rig, observations)), observations)
        for observations in sessions
    ]
    n_starts = 1 + more_starts
    measured_T = torch.stack([posterior.measured_T for posterior in own]).repeat_interleave(n_starts, dim=0)
    together = own[0].with_rows(measured_T)
    starts = torch.cat([_starts(coordinates, seed, more_starts) for seed in seeds])
    possible = torch.isfinite(together(starts))
    starts = torch.where(possible[:, None], starts, coordinates.start())
    first = levenberg_marquardt(together, starts, FIRST_ITERATIONS, TOLERANCE)
    top = first.log_posterior.reshape(len(own), n_starts).argmax(1) + n_starts * torch.arange(len(own))
    fits = levenberg_marquardt(together.at(top), first.vector[top], tolerance=TOLERANCE)
    return [(posterior, fits.rows(slice(i, i + 1))) for i, posterior in enumerate(own)]


def _starts(coordinates: Coordinates, seed: int, more: int) -> torch.Tensor:
    nominal = coordinates.start()[None]
    return (
        torch.cat((nominal, coordinates.sample_prior(np.random.default_rng(seed), more))) if more else nominal
    )

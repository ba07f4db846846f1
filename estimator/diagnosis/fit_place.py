"""Device and precision in which the fits of a diagnosis predict readings: on the processor, on another device, or in single precision.

Only the climb to a maximum may be in single precision. Columns of causes are differences over a thousandth of a prior's width, and
evidences differ by less than single precision tells: both, and the last step of every fit, are made in double precision, where the
readings of the fit are (`elsewhere`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import FirstOrder, LogPosterior
from estimator.inference.secant import climb_with_secants, is_worthwhile
from estimator.model.measurement_model import MeasurementModel

_current: ContextVar[tuple[torch.device, torch.dtype] | None] = ContextVar("current", default=None)


@contextmanager
def climbing_on(device: torch.device, dtype: torch.dtype) -> Iterator[None]:
    """While it lasts, fits climb on a device and with predictions in a precision."""
    token = _current.set((device, dtype))
    try:
        yield
    finally:
        _current.reset(token)


def place_of_climbs() -> str:
    """Device and precision of climbs, in words; empty where they are those of the readings."""
    return "" if (place := _current.get()) is None else f"{place[0]} {place[1]}"


def climbed(
    posterior: LogPosterior,
    start: Float[Tensor, "start coordinate"],
    tolerance: float,
    slopes: Callable[[], FirstOrder | None] = lambda: None,
) -> Optimum:
    """The highest maximum that is reached from some starts, in a race, as `levenberg_marquardt` gives it where the readings are.

    Args:
        posterior: Density to maximise.
        start: Coordinates to start from.
        tolerance: Rise in log density by a further step below which the climb stops.
        slopes: Gives derivatives of a similar model at the only start; None where there are none.
    """
    readings = posterior.model.circumstances.observations
    there = readings if (place := _current.get()) is None else readings.to(*place)
    if there is not readings:
        model = MeasurementModel.unruled(posterior.model.rig, there).with_rules(posterior.model.rules)
        far = LogPosterior(posterior.coordinates, model, there)
        ahead = levenberg_marquardt(far, start.to(there.device), tolerance=tolerance, is_race=True)
        start = ahead.vector[ahead.log_posterior.argmax()][None].to(start.device)
    if is_worthwhile(posterior, start):
        known = slopes() if there is readings else None
        return climb_with_secants(posterior, start, tolerance, known)
    return levenberg_marquardt(posterior, start, tolerance=tolerance, is_race=True)

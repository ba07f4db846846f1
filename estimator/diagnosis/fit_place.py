"""What all fits of a diagnosis share: the journal that remembers them, and the device and precision in which they climb.

Only the climb to a maximum may be in single precision. Columns of causes are differences over a thousandth of a prior's width, and
evidences differ by less than single precision tells: both, and the last step of every fit, are made in double precision, where the
readings of the fit are (`elsewhere`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fit_journal import FitJournal
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import FirstOrder, LogPosterior
from estimator.inference.secant import climb_with_secants, is_worthwhile


@dataclass(frozen=True)
class FitSetting:
    """What all fits of a diagnosis share.

    Attributes:
        journal: Remembers their maxima; None where nothing is remembered.
        place: Device and precision in which they climb; None for those of the readings.
    """

    journal: FitJournal | None = None
    place: tuple[torch.device, torch.dtype] | None = None


NOTHING_SHARED = FitSetting()
SETTING: ContextVar[FitSetting] = ContextVar("SETTING", default=NOTHING_SHARED)


@contextmanager
def fitting_by(setting: FitSetting) -> Iterator[None]:
    """While it lasts, fits are made by a setting, also those on other cores (`side_by_side`)."""
    token = SETTING.set(setting)
    try:
        yield
    finally:
        SETTING.reset(token)


def climbed(
    posterior: LogPosterior,
    start: Float[Tensor, "start coordinate"],
    tolerance: float,
    place: tuple[torch.device, torch.dtype] | None,
    slopes: Callable[[], FirstOrder | None] = lambda: None,
    ends_exact: bool = True,
) -> Optimum:
    """The highest maximum that is reached from some starts, in a race, as `levenberg_marquardt` gives it where the readings are.

    Args:
        posterior: Density to maximise.
        start: Coordinates to start from.
        tolerance: Rise in log density by a further step below which the climb stops.
        place: Device and precision of the climb; None for those of the readings.
        slopes: Gives derivatives of a similar model at the only start; None where there are none.
        ends_exact: Make the Jacobian anew at the maximum, where many numbers are free.
    """
    readings = posterior.model.circumstances.observations
    there = readings if place is None else readings.to(*place)
    if there is not readings:
        far = LogPosterior.by_rules(posterior.coordinates, there, posterior.model.rules)
        ahead = levenberg_marquardt(far, start.to(there.device), tolerance=tolerance, is_race=True)
        start = ahead.vector[ahead.log_posterior.argmax()][None].to(start.device)
    if is_worthwhile(posterior, start):
        known = slopes() if there is readings else None
        return climb_with_secants(posterior, start, tolerance, known, ends_exact=ends_exact)
    return levenberg_marquardt(posterior, start, tolerance=tolerance, is_race=True)

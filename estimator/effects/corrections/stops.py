"""Correction of where a mover stands, for each place at which it stopped: what a hand at a ruler leaves, and all readings there share."""

from __future__ import annotations

from jaxtyping import Int

from estimator.effects.base import WHEN, Theta
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.correction import Limit
from estimator.effects.corrections.targets import Place
from estimator.effects.stages import Columns
from estimator.tensors import Tensor, torch

MOST_STOPS = 100  # each has three numbers, and a fit moves all of them
LEAST_REPEATS = 2  # readings at a stop in the mean: single ones are scatter, which `position_jitter` has
DECIMALS = 9  # of motions that are alike, in m and rad


class StopErrors(Place):
    """Each place at which the mover stopped is off by an error of its own, which all readings there share.

    Degree `n` is the n-th different place of the session. A stop that a prediction asks for is no place of the session.
    """

    name = "stop_errors"
    words = "at each stop the mover stands off by another amount, which all readings there share"
    depends_on = WHEN
    highest = MOST_STOPS
    is_whole = True

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Number of stops, where the readings repeat them; 0 where they do not, or where there are too many."""
        stop = _stops(circumstances.of_history, place)
        n = int(stop.max())
        if n > MOST_STOPS or len(stop) < LEAST_REPEATS * n:
            most = f"read at most {MOST_STOPS} stops, each several times"
            return Limit(0, f"{len(stop)} readings are of {n} stops; {most}")
        return Limit(n)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover stopped at several places."""
        return int(_stops(circumstances.of_history, place).max()) > 1

    def columns(self, circumstances: Circumstances, mover: str) -> Columns:
        """Number of the stop of each reading from 1 on; 0 where a moment stands for a session."""
        return _stops(circumstances, mover).to(circumstances.hours)[:, None]

    def value(self, stop: Columns, theta: Theta) -> Tensor:
        """Shift at each stop."""
        amplitudes = self.amplitudes(theta)
        is_there = (stop == stop.new_tensor([*amplitudes])).to(stop)
        return is_there @ torch.stack(list(amplitudes.values()), dim=-2)


def _stops(circumstances: Circumstances, mover: str) -> Int[Tensor, " reading"]:
    """Number of the place at which the mover stood, in the order of their coordinates; 0 where a moment stands for a session."""
    observations = circumstances.observations
    if circumstances.is_moment:
        return torch.zeros_like(observations.row)
    motion = observations.history.motion[mover]
    _, stop = torch.unique(motion.round(decimals=DECIMALS), dim=0, return_inverse=True)
    return (1 + stop)[observations.row]

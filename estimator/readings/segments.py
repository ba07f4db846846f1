"""Segments of a session: files, days or planes before each of which everything was set up anew.

A session says them by number, or its pauses do. A pause is no proof that anything was touched; it only makes the question possible, and a
cause that needs it still has to earn its evidence.
"""

from __future__ import annotations

from jaxtyping import Float, Int

from estimator.tensors import Tensor, torch

NO_SEGMENT = -1  # of readings outside any
LEAST_PAUSE_S = 3600.0  # a night or a change of the set-up; a coil that cools between two maps takes less
LEAST_PAUSE_INTERVALS = 20.0  # a session that takes one reading an hour all along has no pauses


def segments_by_pauses(time_s: Float[Tensor, " reading"]) -> Int[Tensor, " reading"]:
    """Number of the segment of each reading, counted by pauses; `NO_SEGMENT` throughout where there is none.

    Args:
        time_s: In ascending order.
    Examples:
        >>> segments_by_pauses(torch.tensor([0.0, 1.0, 2.0, 50000.0, 50001.0])).tolist()
        [0, 0, 0, 1, 1]
    """
    steps_s = time_s.diff()
    moving_s = steps_s[steps_s > 0.0]
    typical_s = float(moving_s.median()) if len(moving_s) else 0.0
    is_pause = steps_s > max(LEAST_PAUSE_S, LEAST_PAUSE_INTERVALS * typical_s)
    if not is_pause.any():
        return torch.full((len(time_s),), NO_SEGMENT, device=time_s.device)
    return torch.cat((torch.zeros(1, dtype=torch.int64, device=time_s.device), is_pause.cumsum(0)))


def segments_in_turn(time_s: Float[Tensor, " reading"], n: int) -> Int[Tensor, " reading"]:
    """A session divided into `n` segments of nearly as many instants each, in order of time.

    Examples:
        >>> segments_in_turn(torch.tensor([3.0, 0.0, 0.0, 1.0, 2.0]), 2).tolist()
        [1, 0, 0, 0, 1]
    """
    instants, instant = torch.unique(time_s, return_inverse=True)
    return instant * n // len(instants)

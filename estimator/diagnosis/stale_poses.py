"""Poses that are those of the row before in each n-th row: the arm had not told the new one yet when the row was written down.

Alone such a row may miss by less than readings scatter. Together they are told by three things: their pose is that of the row before to the
last digit, they are equally far apart, and they fit the pose of the row after better.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.expectation import Expectation, distance, predict_T
from estimator.diagnosis.fitting import Fit
from estimator.readings.flags import Flag, Reason
from estimator.readings.observations import Observations

# Rows apart; where each second one repeats its pose, a protocol reads twice at a place
NEAREST, FARTHEST = 3, 100
FEWEST = 3  # such rows
MOST_OF_ONE = 8.0  # log odds that one row counts at most, for it may be wild


def stale_poses(fit: Fit, observations: Observations) -> list[Flag]:
    """The rows, a flag for each sensor; none where they do not tell.

    Args:
        fit: Of the rig.
        observations: A whole session.
    """
    order = observations.time_s.argsort(stable=True)
    pose = torch.cat([motion[order] for motion in observations.motion.values()], dim=1)
    is_repeated = torch.cat(
        (torch.ones_like(order[:1], dtype=torch.bool), (pose[1:] == pose[:-1]).all(dim=1))
    )
    patterns = [rows for rows in _each_nth(is_repeated) if _makes_stops_longer(rows, is_repeated)]
    if not patterns:
        return []
    log_odds = _log_odds_of_the_pose_after(fit, observations, order)
    sums = torch.stack([log_odds[rows].sum() for rows in patterns])
    rows = patterns[int(sums.argmax())]
    rest = torch.ones_like(is_repeated).index_fill(0, rows, False) & is_repeated
    least = policy.LEAST_LOG_EVIDENCE_OF_MISTAKE + math.log(len(patterns))
    if float(sums.max()) < least or float(log_odds[rest].sum()) > 0.0:
        return []
    words = (
        "has the pose of the reading before, as others at equal distances, and fits that of the reading after"
    )
    wrong = order[rows[log_odds[rows] > 0.0]]
    by_sensor = [
        wrong[observations.sensor[wrong] == sensor] for sensor in observations.sensor[wrong].unique()
    ]
    return [
        Flag.of(observations, Reason.OTHERWISE, words, None, own.sort().values.tolist()) for own in by_sensor
    ]


def _each_nth(is_repeated: Bool[Tensor, " row"]) -> Iterator[Int[Tensor, " nth"]]:
    """Rows equally far apart that all repeat the pose of the row before; the first row of all may be one of them."""
    n = len(is_repeated)
    for apart in range(NEAREST, min(FARTHEST, n // FEWEST) + 1):
        for first in range(apart):
            if bool(is_repeated[first::apart].all()):
                yield torch.arange(first, n, apart, device=is_repeated.device)


def _makes_stops_longer(rows: Int[Tensor, " nth"], is_repeated: Bool[Tensor, " row"]) -> bool:
    """Whether stops that end with one of some rows have a row more than others: a protocol that reads several times makes all alike."""
    stop = torch.cumsum(~is_repeated, 0)
    n_rows, n_of_them = torch.bincount(stop), torch.bincount(stop[rows], minlength=int(stop.max()) + 1)
    is_last = torch.cat((~is_repeated[1:], torch.ones_like(is_repeated[:1])))
    ends = stop[rows[is_last[rows]]].unique()
    is_other = (n_rows > 0) & (n_of_them == 0)
    if not len(ends) or not is_other.any():
        return False
    return float(n_rows[ends].double().mean()) > float(n_rows[is_other].double().mean()) + 0.5


def _log_odds_of_the_pose_after(
    fit: Fit, observations: Observations, order: Int[Tensor, " row"]
) -> Float[Tensor, " row"]:
    """Log odds of each row, in order of time, that it has the pose of the row after or its own, against its own; 0 where both agree.

    A row that was taken at the place of the row before has its own. One that fits neither pose was made otherwise.
    """
    after = torch.cat((order[1:], order[-1:]))
    real = {name: motion.index_copy(0, order, motion[after]) for name, motion in observations.motion.items()}
    expected = Expectation(observations, predict_T(fit, fit.values, observations))
    there_T = predict_T(fit, fit.values, replace(observations, motion=real))

    def squares(predicted_T: Tensor) -> Tensor:
        off = (observations.field_sensor_T - predicted_T) / expected.size_T[:, None]
        return off.nan_to_num(0.0).square().sum(dim=1)

    log_odds = (0.5 * (squares(expected.predicted_T) - squares(there_T))).clamp(max=MOST_OF_ONE)
    log_odds = torch.logaddexp(log_odds, torch.zeros_like(log_odds)) - math.log(2.0)
    is_same = torch.stack([(real[n] == observations.motion[n]).all(dim=1) for n in real]).all(dim=0)
    is_far = distance(observations.field_sensor_T, there_T, expected.size_T) > policy.NEAR_TO_EXPECTED
    return log_odds.masked_fill(is_same | is_far, 0.0)[order]

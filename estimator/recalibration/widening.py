"""The old posterior as a widened prior: what a new session starts from.

A refit must be able to follow what may have changed since the last calibration, and nothing else: a winding stays as it is, while
anything mounted may have been mounted anew. What no refit within these priors can follow is left for a diagnosis to name.

Rig files know independent priors, but a posterior is not independent: it knows the field of a winding far better than its radius or its
loops. Priors as wide as each number's own interval would leave the field free by per cents, and a supply that sags would pass for a
winding with half a loop less. So the centre is the point that predicts best, and the widths are those of the product of normals that is
closest to the posterior in Kullback-Leibler divergence: of each number, what the others leave open. Along what n numbers determine together
that product is sqrt(n) times as wide as the posterior.

References: Bishop, Pattern Recognition and Machine Learning (2006), section 10.1.2 (factorised normals have the inverse of the precision's
diagonal for variances).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from estimator.calibration.result import Calibration
from estimator.effects import EFFECTS
from estimator.errors import InvalidInput
from estimator.recalibration import policy
from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior
from estimator.rig.rig import POSE_KEYS, Rig

LENGTHS = ("radius_m", "wire_radius_m", "axial_pitch_m", "radial_pitch_m")
LEAST_SHARE_LEFT = 1e-9  # of a variance: numbers that follow from others by rounding


def widened_rig(calibration: Calibration, described: Rig) -> Rig:
    """The rig of a calibration with its posterior, widened, for a prior.

    Each prior is centred at the posterior's best point, with sd = hypot(what the other numbers leave open of it, what may have changed).

    Args:
        calibration: The version that is current.
        described: The rig as the user describes it, with the priors of the beginning; a cause that was found later has those of its rig.
    """
    rig, left = calibration.rig, _left_sd(calibration)
    widened = rig.with_parameters(
        _widened(parameter, described, calibration.best[parameter.name], left[parameter.name])
        for parameter in rig.free
    )
    broken = widened.broken_rule()
    if broken is not None:
        name, rule, value = broken
        raise InvalidInput(f"{name} {rule}; received {value} (rig {rig.name!r}, the last calibration)")
    return widened


def _widened(parameter: Parameter, described: Rig, best: float, left_sd: float) -> Parameter:
    first = described.parameters.get(parameter.name, parameter).prior or parameter.prior
    assert first is not None
    sd = math.hypot(left_sd, _change(parameter, first, best))
    if isinstance(first, LogNormal):
        return replace(parameter, value=best, prior=LogNormal(best, sd / best, first.lower, first.upper))
    return replace(parameter, value=best, prior=Normal(best, sd, first.lower, first.upper))


def _left_sd(calibration: Calibration) -> dict[str, float]:
    """Of each free parameter, where the others are known; poses, which may change, are not counted among these."""
    found: dict[str, float] = {}
    groups = ([p.name for p in calibration.rig.free if _is_pose(p) == is_pose] for is_pose in (False, True))
    for names in groups:
        draws = np.array([calibration.draws[name].ravel() for name in names]).reshape(len(names), -1)
        sd = draws.std(axis=1)
        scaled = (draws - draws.mean(axis=1, keepdims=True)) / np.where(sd > 0.0, sd, 1.0)[:, None]
        correlation = scaled @ scaled.T / draws.shape[1] + LEAST_SHARE_LEFT * np.eye(len(names))
        share = 1.0 / np.sqrt(np.diag(np.linalg.inv(correlation)))
        found |= dict(zip(names, (sd * share).tolist(), strict=True))
    return found


def _change(parameter: Parameter, first: Prior, best: float) -> float:
    """Standard deviation of what may have changed between two sessions; of the logarithm times the value where the prior is log-normal."""
    body, _, key = parameter.name.rpartition(".")
    if parameter.is_count:
        return policy.LOOPS
    if key in LENGTHS:
        return policy.EXPANSION * best
    share = (
        policy.SHARE_OF_POSE
        if _is_pose(parameter)
        else policy.SHARE_OF_CAUSE
        if _is_of_cause(body)
        else policy.SHARE_OF_AGEING
    )
    return share * (first.relative_sd * best if isinstance(first, LogNormal) else first.sd)


def _is_pose(parameter: Parameter) -> bool:
    body, _, key = parameter.name.rpartition(".")
    return key in POSE_KEYS and not _is_of_cause(body)


def _is_of_cause(body: str) -> bool:
    return body.partition("[")[0] in EFFECTS

"""The current posterior, widened, as the prior of a refit to a new session.

A refit may follow changes that are possible since the last calibration, and no others: a winding stays as it is, but any mounted body may
have been mounted anew. The diagnosis names what no refit within these priors can follow.

Priors of rig files are independent, but the parameters of a posterior are correlated: it determines the field of a winding far better than
its radius or its loops. Priors as wide as the marginal intervals would leave the field free by per cents, and a sagging supply would pass
for a winding with half a loop less. So each prior is centred at the maximum of the posterior, and the widths are those of the product of
normals closest to the posterior in Kullback-Leibler divergence: the standard deviation of each number given the others. Along a direction
that n numbers determine together this product is sqrt(n) times as wide as the posterior.

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
from estimator.rig.bodies import POSE_KEYS
from estimator.rig.natural import SHARE_OF_THICKNESS
from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior
from estimator.rig.rig import Rig

LENGTHS = ("radius_m", "wire_radius_m", "axial_pitch_m", "radial_pitch_m", *SHARE_OF_THICKNESS)
LEAST_SHARE_LEFT = 1e-9  # of a variance: numbers that follow from others by rounding


def widened_rig(calibration: Calibration, described: Rig) -> Rig:
    """The rig of a calibration with its widened posterior as the prior.

    Each prior is centred at the maximum of the posterior, with sd = hypot(sd given the other numbers, sd of possible changes).

    Args:
        calibration: The current version.
        described: The rig as the user describes it, with the first priors; causes found later keep those of their rig.
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
    """Standard deviation of each free parameter given the others of its group: poses, which may change, or all the rest."""
    left: dict[str, float] = {}
    groups = ([p.name for p in calibration.rig.free if _is_pose(p) == is_pose] for is_pose in (False, True))
    for names in filter(None, groups):
        draws = np.array([calibration.draws[name].ravel() for name in names])
        sd = draws.std(axis=1)
        scaled = (draws - draws.mean(axis=1, keepdims=True)) / np.where(sd > 0.0, sd, 1.0)[:, None]
        correlation = scaled @ scaled.T / draws.shape[1] + LEAST_SHARE_LEFT * np.eye(len(names))
        share = 1.0 / np.sqrt(np.diag(np.linalg.inv(correlation)))
        left |= dict(zip(names, (sd * share).tolist(), strict=True))
    return left


def _change(parameter: Parameter, first: Prior, best: float) -> float:
    """Standard deviation of possible changes between two sessions; for log-normal priors that of the logarithm times the value."""
    body, _, key = parameter.name.rpartition(".")
    if parameter.is_count:
        return policy.LOOPS
    if key in LENGTHS:
        return policy.EXPANSION * best
    width = first.relative_sd * best if isinstance(first, LogNormal) else first.sd
    return width if _is_pose(parameter) or _is_of_cause(body) else policy.SHARE_OF_AGEING * width


def _is_pose(parameter: Parameter) -> bool:
    body, _, key = parameter.name.rpartition(".")
    return key in POSE_KEYS and not _is_of_cause(body)


def _is_of_cause(body: str) -> bool:
    return body.partition("[")[0] in EFFECTS

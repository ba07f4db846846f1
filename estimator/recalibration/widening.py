"""The current posterior, widened, as the prior of a refit to a new session.

A refit may follow changes that are possible since the last calibration, and no others: a winding stays as it is, but any mounted body may
have been mounted anew. The diagnosis names what no refit within these priors can follow.

A posterior determines the field of a winding far better than its radius or its loops. Independent priors as wide as its intervals would
leave the field free by per cents, and a sagging supply would pass for a winding with half a loop less; narrower ones would state a radius
as if it were known. So the parameters have one prior together: the mean and covariance of the posterior in the coordinates of a fit, in
which it is close to normal, with the variance of what may have changed. Amplitudes of coils without a winding and of corrections, of which
there may be hundreds, keep priors of their own, as wide as the others leave each open.

References: Bishop, Pattern Recognition and Machine Learning (2006), section 10.1.2 (factorised normals have the inverse of the precision's
diagonal for variances).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.derivatives import jacobian_of
from estimator.effects import EFFECTS
from estimator.errors import InvalidInput
from estimator.inference.collapsed import free_amplitudes
from estimator.recalibration import policy
from estimator.rig.bodies import POSE_KEYS
from estimator.rig.coordinates import Coordinates
from estimator.rig.natural import SHARE_OF_THICKNESS
from estimator.rig.parameters import JointNormal, LogNormal, Normal, Parameter, Prior
from estimator.rig.rig import Rig

LENGTHS = ("radius_m", "wire_radius_m", "axial_pitch_m", "radial_pitch_m", *SHARE_OF_THICKNESS)
LEAST_SHARE_LEFT = 1e-9  # of a variance: numbers that follow from others by rounding


def widened_rig(calibration: Calibration, described: Rig) -> Rig:
    """The rig of a calibration with its widened posterior as the prior, about the mean of its draws.

    Args:
        calibration: The current version.
        described: The rig as the user describes it, with the first priors; causes found later keep those of their rig.
    """
    rig = calibration.rig
    coordinates = Coordinates(rig)
    labels = tuple(f"{correction.label}." for correction in rig.corrections)
    alone = [*free_amplitudes(rig), *(name for name in coordinates.names if name.startswith(labels))]
    draws = {name: torch.tensor(calibration.draws[name].ravel()) for name in coordinates.names}
    mean = coordinates.values(coordinates.vector(draws).mean(0))
    left_sd = {name: float(draw.std()) for name, draw in draws.items()} | _left_sd(calibration, alone)
    parameters, changes = [], {}
    for parameter in rig.free:
        name, centre = parameter.name, float(mean[parameter.name])
        first = described.parameters.get(name, parameter).prior or parameter.prior
        assert first is not None
        changes[name] = _change(parameter, first, centre)
        prior = _widened(first, centre, math.hypot(left_sd[name], changes[name]))
        parameters.append(replace(parameter, value=centre, prior=prior))
    widened = rig.with_parameters(parameters)
    broken = widened.broken_rule()
    if broken is not None:
        name, rule, value = broken
        raise InvalidInput(f"{name} {rule}; received {value} (rig {rig.name!r}, the last calibration)")
    names = [name for name in changes if name not in alone]
    return replace(widened, joint=_joint(draws, widened, names, changes) if names else None)


def _widened(first: Prior, centre: float, sd: float) -> Prior:
    if isinstance(first, LogNormal):
        return LogNormal(centre, sd / centre, first.lower, first.upper)
    return Normal(centre, sd, first.lower, first.upper)


def _joint(
    draws: Mapping[str, Tensor], widened: Rig, names: Sequence[str], changes: Mapping[str, float]
) -> JointNormal:
    """The law of some parameters: covariance of their draws, and to first order that of possible changes."""
    coordinates = Coordinates(widened)
    columns = [coordinates.names.index(name) for name in names]
    nominal, change = (
        torch.tensor([numbers[name] for name in names], dtype=torch.float64)
        for numbers in (widened.nominal_values(), changes)
    )

    def together(values: Mapping[str, Tensor]) -> Tensor:
        return coordinates.unmixed(values)[..., columns]

    changed = jacobian_of(lambda some: together(dict(zip(names, some, strict=True))), nominal) * change
    covariance = torch.cov(together(draws).T).reshape(len(names), len(names)) + changed @ changed.T
    return JointNormal(tuple(names), tuple(map(tuple, (0.5 * (covariance + covariance.T)).tolist())))


def _left_sd(calibration: Calibration, names: Sequence[str]) -> dict[str, float]:
    """Standard deviation of each of some parameters given the others of them."""
    if not names:
        return {}
    draws = np.array([calibration.draws[name].ravel() for name in names])
    sd = draws.std(axis=1)
    scaled = (draws - draws.mean(axis=1, keepdims=True)) / np.where(sd > 0.0, sd, 1.0)[:, None]
    correlation = scaled @ scaled.T / draws.shape[1] + LEAST_SHARE_LEFT * np.eye(len(names))
    share = 1.0 / np.sqrt(np.diag(np.linalg.inv(correlation)))
    return dict(zip(names, (sd * share).tolist(), strict=True))


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

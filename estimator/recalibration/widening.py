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

import json
import math
from typing import Any

import numpy as np
import yaml

from estimator.calibration.result import Calibration
from estimator.effects import EFFECTS
from estimator.rig.parameters import LogNormal, Parameter, Prior
from estimator.rig.rig import POSE_KEYS, Rig
from estimator.rig_files.read import rig_from_text
from estimator.units import split_unit

EXPANSION = 3e-4  # of a winding's lengths: copper by 20 K
LOOPS = 0.01  # a winding keeps its loops; its leads are part of one
SHARE = 0.1  # of the first prior's width: what ageing may do to a sensor or a supply between two sessions
SHARE_OF_POSE = 1.0  # a body that is mounted anew stands where it could have stood before the first session
SHARE_OF_CAUSE = 1.0  # a cause that has begun may go on
LENGTHS = ("radius_m", "wire_radius_m", "axial_pitch_m", "radial_pitch_m")
LEAST_SHARE_LEFT = 1e-9  # of a variance: numbers that follow from others by rounding
HOLDERS = ("movers", "coils", "sensors", "effects")  # the sections with parameters
NOTE = "# Priors: the last calibration's posterior, widened by coilcal recalibrate."


def widened_rig(calibration: Calibration, described: Rig) -> Rig:
    """The rig of a calibration with its widened posterior as the prior.

    Each prior is centred at the maximum of the posterior, with sd = hypot(sd given the other numbers, sd of possible changes).

    Args:
        calibration: The current version.
        described: The rig as the user describes it, with the first priors; causes found later keep those of their rig.
    """
    rig = calibration.rig
    tree = json.loads(json.dumps(yaml.safe_load(rig.text)))  # what anchors share becomes each body's own
    left = _left_sd(calibration)
    for parameter in rig.free:
        first = described.parameters.get(parameter.name, parameter).prior or parameter.prior
        best = calibration.best[parameter.name]
        assert first is not None
        change = _change(parameter, first, best)
        _replace(tree, parameter, _entry(first, best, math.hypot(left[parameter.name], change)))
    return rig_from_text(NOTE + "\n" + yaml.safe_dump(tree, sort_keys=False, width=130), f"rig {rig.name!r}")


def _left_sd(calibration: Calibration) -> dict[str, float]:
    """Standard deviation of each free parameter given the others of its group: poses, which may change, or all the rest."""
    left: dict[str, float] = {}
    groups = ([p.name for p in calibration.rig.free if _is_pose(p) == is_pose] for is_pose in (False, True))
    for names in groups:
        draws = np.array([calibration.draws[name].ravel() for name in names]).reshape(len(names), -1)
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
        return LOOPS
    if key in LENGTHS:
        return EXPANSION * best
    share = SHARE_OF_POSE if _is_pose(parameter) else SHARE_OF_CAUSE if _is_of_cause(body) else SHARE
    return share * (first.relative_sd * best if isinstance(first, LogNormal) else first.sd)


def _is_pose(parameter: Parameter) -> bool:
    body, _, key = parameter.name.rpartition(".")
    return key in POSE_KEYS and not _is_of_cause(body)


def _is_of_cause(body: str) -> bool:
    return body.partition("[")[0] in EFFECTS


def _entry(first: Prior, centre: float, sd: float) -> dict[str, Any]:
    """One number in the notation of rig files, in SI."""
    bounds = {key: end for key in ("lower", "upper") if math.isfinite(end := getattr(first, key))}
    if isinstance(first, LogNormal):
        prior = {"log_normal": {"median": centre, "relative_sd": sd / centre, **bounds}}
    else:
        prior = {"normal": {"mean": centre, "sd": sd, **bounds}}
    return {"value": centre, "prior": prior}


def _replace(tree: dict[str, Any], parameter: Parameter, entry: dict[str, Any]) -> None:
    """Put an entry in SI in the place of a parameter's, whatever unit that was written in."""
    body, *blocks, key = parameter.name.split(".")
    (node,) = (tree[kind][body] for kind in HOLDERS if body in tree.get(kind, {}))
    for block in blocks:
        node = node[block]
    entries = {key if _is_same(written, key) else written: value for written, value in node.items()}
    node.clear()
    node.update({**entries, key: entry})


def _is_same(written: str, key: str) -> bool:
    """Whether a key of the file states the quantity of an SI key, as radius_mm that of radius_m."""
    (quantity, unit), (wanted, si) = split_unit(written), split_unit(key)
    return written == key or (
        quantity == wanted and unit is not None and si is not None and unit.dimension == si.dimension
    )

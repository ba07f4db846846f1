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

import json
import math
from typing import Any

import numpy as np
import yaml

from estimator.calibration.result import Calibration
from estimator.effects import EFFECTS
from estimator.recalibration import policy
from estimator.rig.parameters import LogNormal, Parameter, Prior
from estimator.rig.rig import POSE_KEYS, Rig
from estimator.rig_files.read import rig_from_text
from estimator.units import split_unit

LENGTHS = ("radius_m", "wire_radius_m", "axial_pitch_m", "radial_pitch_m")
LEAST_SHARE_LEFT = 1e-9  # of a variance: numbers that follow from others by rounding
HOLDERS = ("movers", "coils", "sensors", "effects")  # the sections with parameters
NOTE = "# Priors: the last calibration's posterior, widened by coilcal recalibrate."


def widened_rig(calibration: Calibration, described: Rig) -> Rig:
    """The rig of a calibration with its posterior, widened, for a prior.

    Each prior is centred at the posterior's best point, with sd = hypot(what the other numbers leave open of it, what may have changed).

    Args:
        calibration: The version that is current.
        described: The rig as the user describes it, with the priors of the beginning; a cause that was found later has those of its rig.
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
    """Whether a key of the file states the quantity of an SI key, such as radius_mm that of radius_m."""
    (quantity, unit), (wanted, si) = split_unit(written), split_unit(key)
    return written == key or (
        quantity == wanted and unit is not None and si is not None and unit.dimension == si.dimension
    )

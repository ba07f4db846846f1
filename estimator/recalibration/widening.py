"""The old posterior as a widened prior: what a new session starts from.

A refit must be able to follow what may have changed since the last calibration, and nothing else: a winding stays as it is, while
anything mounted may have been mounted anew. What no refit within these priors can follow is left for a diagnosis to name.
"""

from __future__ import annotations

import json
import math
from typing import Any

import yaml

from estimator.calibration import Calibration
from estimator.config import rig_from_text
from estimator.parameters import LogNormal, Parameter, Prior
from estimator.rig import POSE_KEYS, Rig
from estimator.units import split_unit

POSTERIOR_SDS = (
    3.0  # of the last posterior, which is narrower than the truth where the model is not quite right
)
SHARE = 0.1  # of the first prior's width: what ageing may do to a winding or a sensor between two sessions
SHARE_OF_POSE = 1.0  # a body that is mounted anew stands where it could have stood before the first session
HOLDERS = ("movers", "coils", "sensors", "effects")  # the sections with parameters
NOTE = "# Priors: the last calibration's posterior, widened by coilcal recalibrate."


def widened_rig(calibration: Calibration, described: Rig) -> Rig:
    """The rig of a calibration with its posterior, widened, for a prior.

    Each prior is centred at the posterior's median, with sd = sqrt((2 sd of the posterior)^2 + (share of the first prior's sd)^2).

    Args:
        calibration: The version that is current.
        described: The rig as the user describes it, with the priors of the beginning; a cause that was found later has those of its rig.
    """
    rig = calibration.rig
    tree = json.loads(json.dumps(yaml.safe_load(rig.text)))  # what anchors share becomes each body's own
    for parameter in rig.free:
        first = described.parameters.get(parameter.name, parameter).prior or parameter.prior
        own = calibration.record["parameters"][parameter.name]
        assert first is not None
        _replace(tree, parameter, _entry(parameter, first, own["median"], own["sd"]))
    return rig_from_text(NOTE + "\n" + yaml.safe_dump(tree, sort_keys=False, width=130), f"rig {rig.name!r}")


def _entry(parameter: Parameter, first: Prior, median: float, sd: float) -> dict[str, Any]:
    """One number in the notation of rig files, in SI."""
    body, _, key = parameter.name.rpartition(".")
    share = SHARE_OF_POSE if key in POSE_KEYS and "[" not in body else SHARE
    bounds = {key: end for key in ("lower", "upper") if math.isfinite(end := getattr(first, key))}
    if isinstance(first, LogNormal):
        relative_sd = math.hypot(POSTERIOR_SDS * sd / median, share * first.relative_sd)
        prior = {"log_normal": {"median": median, "relative_sd": relative_sd, **bounds}}
    else:
        width = math.hypot(POSTERIOR_SDS * sd, share * first.sd)
        prior = {"normal": {"mean": median, "sd": width, **bounds}}
    return {"value": median, "prior": prior}


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

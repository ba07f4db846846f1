"""Predictions of a calibration at a service; places inside a winding are NaN."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.client.steps import Steps, send, send_json

if TYPE_CHECKING:
    import pyarrow as pa

Axis = tuple[float, float, int]
AT_ZERO: Axis = (0.0, 0.0, 1)
Currents = Mapping[str, float]
Points = Float[Tensor, "point 3"]
Gradients = Float[Tensor, "point 3 3"]
Motion = Mapping[str, Float[Tensor, " 6"]]


def field(
    calibration_id: str, points_m: Points, currents_A: Currents, motion: Motion | None
) -> Steps[Points]:
    """Flux density in tesla."""
    asked = {"has_intervals": False}
    return (yield from _predicted(calibration_id, points_m, currents_A, motion, asked))["field_T"]


def gradient(
    calibration_id: str, points_m: Points, currents_A: Currents, motion: Motion | None
) -> Steps[Gradients]:
    """dB_i / dx_j in T/m."""
    asked = {"has_field": False, "has_gradient": True, "has_intervals": False}
    return (yield from _predicted(calibration_id, points_m, currents_A, motion, asked))["gradient_T_per_m"]


def field_interval(
    calibration_id: str, points_m: Points, currents_A: Currents, level: float, motion: Motion | None
) -> Steps[tuple[Points, Points]]:
    """Ends of the credible interval of the flux density."""
    answer = yield from _predicted(calibration_id, points_m, currents_A, motion, {"level": level})
    return answer["field_lower_T"], answer["field_upper_T"]


def gradient_interval(
    calibration_id: str, points_m: Points, currents_A: Currents, level: float, motion: Motion | None
) -> Steps[tuple[Gradients, Gradients]]:
    """Ends of the credible interval of the gradient."""
    asked = {"has_field": False, "has_gradient": True, "level": level}
    answer = yield from _predicted(calibration_id, points_m, currents_A, motion, asked)
    return answer["gradient_lower_T_per_m"], answer["gradient_upper_T_per_m"]


def grid(
    calibration_id: str,
    currents_A: Currents,
    level: float,
    motion: Motion | None,
    axes: Mapping[str, Axis],
    has_gradient: bool,
) -> Steps[pa.Table]:
    """Field on a regular grid, with intervals, as an Arrow table.

    Raises:
        ModuleNotFoundError: pyarrow is missing; `pip install pyarrow`.
    """
    import pyarrow as pa  # only here, for it is larger than all else that a client needs

    body: dict[str, Any] = {
        name: {"first_m": first_m, "last_m": last_m, "n": n} for name, (first_m, last_m, n) in axes.items()
    }
    body |= {**_wish(currents_A, motion), "level": level, "has_gradient": has_gradient}
    answer = yield from send("POST", f"/v1/calibrations/{calibration_id}/grid.arrow", json=body)
    return pa.ipc.open_stream(answer.content).read_all()


def _predicted(
    calibration_id: str,
    points_m: Tensor,
    currents_A: Currents,
    motion: Motion | None,
    asked: Mapping[str, Any],
) -> Steps[dict[str, Tensor]]:
    """What was asked for, as tensors."""
    body = {"points_m": points_m.tolist(), **_wish(currents_A, motion), **asked}
    answer = yield from send_json("POST", f"/v1/calibrations/{calibration_id}/predict", json=body)
    return {name: torch.tensor(_nans(values), dtype=torch.float64) for name, values in answer.items()}


def _wish(currents_A: Currents, motion: Motion | None) -> dict[str, Any]:
    motions = {name: values.tolist() for name, values in (motion or {}).items()}
    return {"currents_A": dict(currents_A), "motion": motions}


def _nans(values: Any) -> Any:
    """Numbers in nested lists, NaN in place of None."""
    if isinstance(values, list):
        return [_nans(value) for value in values]
    return math.nan if values is None else values

"""Readings as named arrays, as sessions store them, and their digest."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.tensors import torch

ARRAYS = (
    "time_s|sensor_index|current_A|field_sensor_T|is_validation|repeat|current_measured_A|segment|line"
    "|motion_[^/]+|temperature_[^/]+_C"
)  # of `observation_arrays`, and the lines of a file


def observation_arrays(o: Observations) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Readings as named arrays with their dimensions, as they are stored."""
    arrays = {
        "time_s": (("reading",), o.time_s.numpy()),
        "sensor_index": (("reading",), o.sensor.numpy()),
        "current_A": (("reading", "coil"), o.current_A.numpy()),
        "field_sensor_T": (("reading", "component"), o.field_sensor_T.numpy()),
        "is_validation": (("reading",), o.is_validation.numpy()),
        "repeat": (("reading",), o.repeat.numpy()),
    }
    arrays |= {f"motion_{name}": (("reading", "axis"), motion.numpy()) for name, motion in o.motion.items()}
    arrays |= {f"temperature_{name}_C": (("reading",), t.numpy()) for name, t in o.temperature_C.items()}
    if o.current_measured_A is not None:
        arrays["current_measured_A"] = ("reading", "coil"), o.current_measured_A.numpy()
    if o.recorded_segment is not None:
        arrays["segment"] = ("reading",), o.recorded_segment.numpy()
    return arrays


def observations_from(stored: Mapping[str, np.ndarray], rig: Rig) -> Observations:
    """Readings from the arrays of `observation_arrays`."""
    tensors = {name: torch.from_numpy(np.array(data)) for name, data in stored.items()}
    return Observations(
        tensors["time_s"],
        tensors["sensor_index"],
        tensors["current_A"],
        {mover.name: tensors[f"motion_{mover.name}"] for mover in rig.movers},
        tensors["field_sensor_T"],
        tensors["is_validation"],
        tensors["repeat"],
        {
            name.removeprefix("temperature_").removesuffix("_C"): data
            for name, data in tensors.items()
            if name.startswith("temperature_")
        },
        current_measured_A=tensors.get("current_measured_A"),
        recorded_segment=tensors.get("segment"),
        line=tensors.get("line"),
    )


def digest(arrays: Mapping[str, tuple[tuple[str, ...], np.ndarray]], attributes: Mapping[str, Any]) -> str:
    """SHA-256 over named arrays with their dimensions, and over JSON attributes."""
    result = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for name in sorted(arrays):
        dimensions, data = arrays[name]
        result.update(f"{name} {dimensions} {data.dtype.str} {data.shape}".encode())
        result.update(np.ascontiguousarray(data).reshape(-1).view(np.uint8).data)
    return result.hexdigest()


@contextmanager
def quiet_zarr() -> Iterator[None]:
    """Silence zarr's warnings about unknown files: users may add notes, and missing chunks are detected by the SHA-256."""
    from zarr.errors import ZarrUserWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)
        yield

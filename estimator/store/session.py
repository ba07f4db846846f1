"""A session: the readings of one visit to one rig, in a zarr v3 group that plain xarray opens.

Every chunk carries a crc32c, and the group a SHA-256 over all arrays and the rig, because zarr reads a missing chunk as fill values
without a word. The rig's YAML travels inside, so a session is complete by itself.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from estimator.config import rig_from_text
from estimator.errors import CoilcalError, CorruptStore, InvalidInput
from estimator.records import Observations
from estimator.rig import Rig

SCHEMA_VERSION = 1
KIND = "coilcal session"


@dataclass(frozen=True)
class Session:
    """Readings with the rig they were taken on.

    Attributes:
        rig: As described in its YAML file.
        observations: The readings.
        source: Where they come from, in words.
        created: ISO date and time of the record.
        truth: Values a simulation used, by parameter name; empty for measured data.
    """

    rig: Rig
    observations: Observations
    source: str
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    truth: Mapping[str, float] = field(default_factory=dict)

    @property
    def hash(self) -> str:
        """SHA-256 over readings and rig; the same readings always give the same hash."""
        return _digest(observation_arrays(self.observations), self.rig.text)

    def with_rig(self, rig: Rig) -> Session:
        """The same readings under another description of the rig, which must name the same things."""
        for kind in ("coils", "sensors", "movers"):
            have = [body.name for body in getattr(self.rig, kind)]
            want = [body.name for body in getattr(rig, kind)]
            if have != want:
                raise InvalidInput(f"the rig's {kind} must be those of the session, {have}; received {want}")
        return replace(self, rig=rig)

    def save(self, path: Path, overwrite: bool = False) -> None:
        """Write the session, whole or not at all.

        Raises:
            InvalidInput: The path exists and `overwrite` is not set, or it cannot be written.
        """
        if path.exists() and not overwrite:
            raise InvalidInput(f"output must not exist yet, or be replaced with --overwrite; received {path}")
        partial = path.with_name(path.name + ".partial")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(partial, ignore_errors=True)
            self._write(partial)
            if path.exists():
                shutil.rmtree(path)
            partial.rename(path)
        except OSError as error:
            shutil.rmtree(partial, ignore_errors=True)
            raise InvalidInput(f"output must be writable; {path} is not: {error}") from error

    def _write(self, path: Path) -> None:
        group = zarr.open_group(path, mode="w", zarr_format=3)
        arrays = observation_arrays(self.observations)
        for name, (dimensions, data) in arrays.items():
            array = group.create_array(
                name,
                shape=data.shape,
                chunks=tuple(max(1, min(n, 65_536)) for n in data.shape),
                dtype=data.dtype,
                compressors=[ZstdCodec(level=3), Crc32cCodec()],
                dimension_names=list(dimensions),
            )
            array[...] = data
        group.attrs.update(
            {
                "kind": KIND,
                "schema_version": SCHEMA_VERSION,
                "created": self.created,
                "source": self.source,
                "truth": dict(self.truth),
                "rig": self.rig.text,
                "coil": [coil.name for coil in self.rig.coils],
                "sensor": [sensor.name for sensor in self.rig.sensors],
                "sha256": _digest(arrays, self.rig.text),
            }
        )


def load_session(path: Path | str) -> Session:
    """Open a session and check every byte of it.

    Raises:
        InvalidInput: No session at this path.
        CorruptStore: A file is missing, truncated or altered, or the schema is of another version.
    """
    path = Path(path)
    if not (path / "zarr.json").is_file():
        raise InvalidInput(f"session must be a zarr folder made by coilcal; received {path}")
    try:
        group = zarr.open_group(path, mode="r")
        attributes: dict[str, Any] = json.loads(json.dumps(group.attrs.asdict()))
        _check_kind(attributes, path)
        stored = {name: np.asarray(array[...]) for name, array in group.arrays()}
        rig = rig_from_text(attributes["rig"], f"rig inside {path}")
        session = Session(
            rig,
            observations_from(stored, rig),
            str(attributes["source"]),
            str(attributes["created"]),
            attributes["truth"],
        )
        digest = session.hash
    except CoilcalError:
        raise
    except Exception as error:  # whatever zarr, JSON or NumPy make of damaged bytes
        raise CorruptStore(
            f"session must be readable; {path} is damaged: {type(error).__name__} {error}"
        ) from error
    if digest != attributes.get("sha256"):
        raise CorruptStore(f"session must match its SHA-256; {path} was altered or lost a chunk")
    return session


def _check_kind(attributes: Mapping[str, Any], path: Path) -> None:
    if attributes.get("kind") != KIND:
        raise InvalidInput(f"session must be of kind {KIND!r}; received {attributes.get('kind')!r} ({path})")
    if attributes.get("schema_version") != SCHEMA_VERSION:
        raise CorruptStore(
            f"session schema_version must be {SCHEMA_VERSION}; received {attributes.get('schema_version')!r} ({path})"
        )


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
    return arrays


def observations_from(stored: Mapping[str, np.ndarray], rig: Rig) -> Observations:
    """Readings from the arrays that `observation_arrays` gave."""
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
    )


def _digest(arrays: Mapping[str, tuple[tuple[str, ...], np.ndarray]], rig_text: str) -> str:
    digest = hashlib.sha256(rig_text.encode())
    for name in sorted(arrays):
        data = np.ascontiguousarray(arrays[name][1])
        digest.update(f"{name} {data.dtype.str} {data.shape}".encode())
        digest.update(data.tobytes())
    return digest.hexdigest()

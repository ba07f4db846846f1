"""An emcee backend that stores the ensemble's chain in zarr, so that a killed run continues from its last checkpoint.

Every `checkpoint_steps` steps, the new steps go to disk in two stages:

1. New rows are written to the arrays: new chunk files, and longer arrays.
2. The group's `zarr.json` is replaced atomically. This replacement is the commit: its attributes hold the number of
   committed steps, a checksum of the committed rows of each array, and the random state.

A kill between any two file operations leaves the old `zarr.json` in force; rows beyond its count are ignored and
later overwritten. (Since 3.1.3 zarr also replaces chunk files and array metadata atomically.) The checksums detect
damage that zarr overlooks, such as a missing chunk file, which it reads as fill values.

A continued run gives, bit by bit, the chain of an uninterrupted one, because each checkpoint holds all that the
sampler carries from step to step: positions, log-probabilities and the random state. Moves must therefore not
adapt (`tune=True` changes a move in memory only); what they prepare must follow
from seed and number of the step. Only one process at a time may write to a store.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from emcee import State
from emcee.backends import Backend
from numpy.typing import NDArray
from zarr.codecs import Crc32cCodec, ZstdCodec

from estimator.errors import CorruptStore, InvalidInput, quoted
from estimator.given_files import MOST_RESULT_BYTES, read_given
from estimator.json_files import json_object
from estimator.store.files import sync, write_bytes, writing
from estimator.store.staging import staged

SCHEMA_VERSION = 1

# Name -> dimensions and fill value, which also sets the type. No row can equal the fill value. Zarr omits only chunks
# of fill values, so every chunk is written, and a lost one fails its checksum.
_ARRAYS: dict[str, tuple[tuple[str, ...], np.generic]] = {
    "chain": (("step", "walker", "coordinate"), np.float64(np.nan)),
    "log_prob": (("step", "walker"), np.float64(np.nan)),
    "checkpoint": (("checkpoint",), np.int64(-1)),  # steps committed by then; a coordinate in xarray
    "accepted": (("checkpoint", "walker"), np.int64(-1)),  # proposals accepted since the first step
}


class ZarrBackend(Backend):  # type: ignore[misc]  # emcee is untyped
    """An emcee backend that checkpoints to a zarr group, made by `create` and reopened by `open`.

    As in emcee's own `Backend`, the whole chain is also in memory, for `get_chain` and similar methods.
    `get_last_sample()` includes the random state, so a run continues with
    `sampler.sample(backend.get_last_sample(), ...)`. While `iteration` is 0, the caller starts the run from its own
    first ensemble and seed. Blobs are not supported.

    References:
        Foreman-Mackey et al., "emcee: The MCMC Hammer", PASP 125, 306 (2013); interface: emcee 3.1,
        `backends/backend.py`.

    Examples:
        >>> import tempfile, emcee
        >>> folder = tempfile.TemporaryDirectory()
        >>> path, fingerprint = Path(folder.name) / "chain.zarr", "session A, seed 1"
        >>> backend = ZarrBackend.create(
        ...     path, coordinate_names=["x"], n_walkers=4, checkpoint_steps=5, fingerprint=fingerprint
        ... )
        >>> def log_prob(x):
        ...     return -0.5 * x[:, 0] ** 2
        >>> sampler = emcee.EnsembleSampler(4, 1, log_prob, backend=backend, vectorize=True)
        >>> _ = sampler.run_mcmc(np.array([[-1.0], [0.0], [0.5], [1.0]]), 12)
        >>> ZarrBackend.open(path).iteration
        10
        >>> backend.flush()
        >>> ZarrBackend.open(path, fingerprint=fingerprint).get_chain().shape
        (12, 4, 1)
        >>> folder.cleanup()
    """

    def __init__(self, path: Path, attributes: Mapping[str, Any]) -> None:
        """Load the committed steps; call `create` or `open` instead."""
        super().__init__(dtype=np.float64)
        self.path = path
        self._committed = attributes
        super().reset(attributes["n_walkers"], len(attributes["coordinate_names"]))
        stored = {name: _read_rows(path, name, attributes) for name in _ARRAYS}
        self.iteration = attributes["n_steps"]
        self.chain, self.log_prob = stored["chain"], stored["log_prob"]
        if self.iteration > 0:
            self.accepted = stored["accepted"][-1].astype(np.float64)
            generator, key, *position = attributes["random_state"]
            self.random_state = (generator, np.array(key, dtype=np.uint32), *position)

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        coordinate_names: Sequence[str],
        n_walkers: int,
        checkpoint_steps: int,
        fingerprint: str,
    ) -> ZarrBackend:
        """Make an empty chain store.

        Args:
            path: Folder that does not exist yet; missing parents are made.
            coordinate_names: One name per coordinate of a walker, stored as an attribute.
            n_walkers: Number of walkers in the ensemble.
            checkpoint_steps: Steps between commits, and the length of a chunk.
            fingerprint: Hash of everything that determines the chain (session, rig, settings, seed).

        Raises:
            InvalidInput: The path exists or cannot be written, or a count is below 1.
        """
        attributes = {
            "schema_version": SCHEMA_VERSION,
            "fingerprint": fingerprint,
            "coordinate_names": list(coordinate_names),
            "n_walkers": n_walkers,
            "checkpoint_steps": checkpoint_steps,
            "n_steps": 0,
            "n_checkpoints": 0,
            "array_crc32": dict.fromkeys(_ARRAYS, 0),
            "random_state": None,
        }
        if min(len(coordinate_names), n_walkers, checkpoint_steps) < 1:
            counts = f"{len(coordinate_names)}, {n_walkers} and {checkpoint_steps}"
            raise InvalidInput(
                f"coordinates, n_walkers and checkpoint_steps must be >= 1; received {counts} ({path})"
            )
        with staged(path) as unfinished:
            unfinished.mkdir()
            for name, (dimensions, fill_value) in _ARRAYS.items():
                _, chunk_shape = _layout(name, attributes)
                zarr.create_array(
                    unfinished / name,
                    shape=(0, *chunk_shape[1:]),
                    chunks=chunk_shape,
                    dtype=fill_value.dtype,
                    fill_value=fill_value,
                    dimension_names=dimensions,
                    compressors=[ZstdCodec(level=3), Crc32cCodec()],
                )
            (unfinished / "zarr.json").write_bytes(_render_group(attributes))
        return cls(path, attributes)

    @classmethod
    def open(cls, path: Path, *, fingerprint: str | None = None) -> ZarrBackend:
        """Open a store at its last commit, after checking every committed row; nothing is written.

        Args:
            path: Folder made by `create`.
            fingerprint: Fingerprint that the chain must have; None accepts any chain.

        Raises:
            InvalidInput: There is no store at the path, or its fingerprint differs.
            CorruptStore: A file is missing, truncated, altered or of another schema version.
        """
        if not path.is_dir():
            raise InvalidInput(f"chain store must be an existing folder; received {path}")
        attributes = _read_attributes(path)
        stored = attributes["fingerprint"]
        if fingerprint not in (None, stored):
            raise InvalidInput(
                f"chain store must have the fingerprint {fingerprint!r}; received {quoted(stored)} ({path})"
            )
        return cls(path, attributes)

    def reset(self, nwalkers: int, ndim: int) -> None:
        """Refuse emcee's `sampler.reset()`, which would discard a checkpointed chain."""
        raise InvalidInput(f"a checkpointed chain must not be reset; use `discard` instead ({self.path})")

    def grow(self, ngrow: int, blobs: object) -> None:
        """Make room in memory for `ngrow` steps after the last one."""
        if blobs is not None:
            raise InvalidInput(f"log_prob must return no blobs; received blobs ({self.path})")
        # Drop room left over by an interrupted call: emcee fails if there is more than it asks for.
        self.chain, self.log_prob = self.chain[: self.iteration], self.log_prob[: self.iteration]
        super().grow(ngrow, blobs)

    def save_step(self, state: State, accepted: NDArray[np.bool_]) -> None:
        """Store one step of the sampler, and commit when a chunk is full."""
        super().save_step(state, accepted)
        if self.iteration % self._committed["checkpoint_steps"] == 0:
            self.flush()

    def flush(self) -> None:
        """Commit all steps so far; call it once at the end of a run.

        A last chunk that is not full is written again when the run continues. Its committed steps do not change,
        so a kill at that moment does no harm either.

        Raises:
            InvalidInput: The store cannot be written (no space, no permission); the last commit remains.
        """
        before = self._committed
        if self.iteration == before["n_steps"]:
            return
        new_steps = slice(before["n_steps"], self.iteration)
        new_rows = {
            "chain": self.chain[new_steps],
            "log_prob": self.log_prob[new_steps],
            "checkpoint": np.array([self.iteration]),
            "accepted": self.accepted.astype(np.int64)[np.newaxis],
        }
        old_crc32 = before["array_crc32"]
        generator, key, *position = self.random_state
        after = {
            **before,
            "n_steps": self.iteration,
            "n_checkpoints": before["n_checkpoints"] + 1,
            "array_crc32": {n: zlib.crc32(new.tobytes(), old_crc32[n]) for n, new in new_rows.items()},
            "random_state": [generator, key.tolist(), *position],
        }
        with writing(self.path, "chain store"):
            for name, new in new_rows.items():
                _append_rows(self.path / name, _layout(name, before)[0], new)
            # Written inside an array, so that a file left behind by a kill does not appear in a listing of the group.
            write_bytes(self.path / "zarr.json", _render_group(after), scratch=self.path / "chain")
            sync(self.path)
        self._committed = after


def _layout(name: str, attributes: Mapping[str, Any]) -> tuple[int, tuple[int, ...]]:
    """Number of committed rows of an array, and shape of its chunks; each checkpoint adds a chunk."""
    first, *other_dimensions = _ARRAYS[name][0]
    sizes = {
        "walker": attributes["n_walkers"],
        "coordinate": len(attributes["coordinate_names"]),
        "step": attributes["checkpoint_steps"],
        "checkpoint": 1,
    }
    return attributes[f"n_{first}s"], tuple(sizes[dimension] for dimension in (first, *other_dimensions))


def _render_group(attributes: Mapping[str, Any]) -> bytes:
    """The group's `zarr.json`, sealed with a checksum of its attributes."""
    seal = zlib.crc32(json.dumps(attributes).encode())
    group = {"zarr_format": 3, "node_type": "group", "attributes": {**attributes, "attributes_crc32": seal}}
    return json.dumps(group).encode()


def _read_attributes(path: Path) -> dict[str, Any]:
    """Attributes of the last commit; the file must be byte for byte what a commit writes."""
    try:
        content = read_given(path / "zarr.json", MOST_RESULT_BYTES, CorruptStore)
        attributes: dict[str, Any] = json_object(content, path / "zarr.json", CorruptStore)["attributes"]
        version, _ = attributes["schema_version"], attributes.pop("attributes_crc32")
    except (CorruptStore, KeyError, TypeError, AttributeError) as error:
        raise CorruptStore(f"zarr.json of chain store {path} is missing, truncated or altered") from error
    if version != SCHEMA_VERSION:
        raise CorruptStore(
            f"chain store must have schema version {SCHEMA_VERSION}; received {quoted(version)} ({path})"
        )
    if _render_group(attributes) != content:
        raise CorruptStore(f"zarr.json of chain store {path} is altered: its checksum does not match")
    return attributes


def _read_rows(path: Path, name: str, attributes: Mapping[str, Any]) -> NDArray[Any]:
    """Committed rows of one array, checked against its layout and checksum."""
    n_rows, chunk_shape = _layout(name, attributes)
    dimensions, fill_value = _ARRAYS[name]
    try:
        array: Any = zarr.open_array(path / name, mode="r")
        layout = (array.metadata.dimension_names, array.dtype, array.chunks, array.shape[1:])
        if layout != (dimensions, fill_value.dtype, chunk_shape, chunk_shape[1:]):
            raise ValueError(f"unexpected layout {layout}")
        rows: NDArray[Any] = array[:n_rows]
        if zlib.crc32(rows.tobytes()) != attributes["array_crc32"][name]:
            raise ValueError("checksum does not match")
    except Exception as error:  # damaged files raise errors of nearly any type inside zarr and its codecs
        raise CorruptStore(f"array {name!r} of chain store {path} has a missing or altered file") from error
    return rows


def _append_rows(path: Path, n_rows: int, new: NDArray[Any]) -> None:
    """Replace everything after the first `n_rows` rows of an array, and wait until it is on disk."""
    array: Any = zarr.open_array(path, mode="r+")
    array.resize((n_rows + len(new), *array.shape[1:]))
    array[n_rows:] = new
    length, *row_shape = array.chunks
    for index in range(n_rows // length, math.ceil(array.shape[0] / length)):
        sync(path / array.metadata.encode_chunk_key((index, *[0] * len(row_shape))))
    sync(path / "zarr.json")

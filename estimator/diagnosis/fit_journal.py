"""A file that remembers the fits of a diagnosis, so that one which was interrupted continues where it was.

A diagnosis is deterministic: started again, it asks for the same fits in the same order, and those that the file holds cost nothing. The
result is, bit by bit, that of an uninterrupted run.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

import numpy as np
import torch
from torch import Tensor

from estimator.code_version import code_version
from estimator.devices import numpy_of
from estimator.errors import CorruptStore
from estimator.field.winding_shape import Rule
from estimator.given_files import MOST_TABLE_BYTES, read_given
from estimator.inference.levenberg_marquardt import Optimum
from estimator.json_files import json_object, sealed, unsealed
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.files import append_text, write_bytes

FITS = "fits.jsonl"


class FitJournal:
    """Maxima by what was fitted, in a file with one line each.

    Args:
        path: The file. A line that was torn by an interruption or altered since is dropped, and its maximum is sought again.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines: dict[str, str] = {}
        self._writing = Lock()  # fits end in several threads, and their long lines must not mix
        if path.exists():
            content = read_given(path, MOST_TABLE_BYTES, CorruptStore)
            whole = b"".join(line for line in content.splitlines(keepends=True) if self._take(line))
            if whole != content:
                write_bytes(path, whole)

    def _take(self, line: bytes) -> bool:
        """Whether a line is whole; it is remembered then."""
        try:
            known = unsealed(json_object(line, self.path, CorruptStore), self.path, CorruptStore)
        except CorruptStore:
            return False
        if not line.endswith(b"\n") or not isinstance(known.get("key"), str):
            return False
        self._lines[known["key"]] = line.decode()
        return True

    def __len__(self) -> int:
        return len(self._lines)

    def optimum(self, key: str) -> Optimum | None:
        """The maximum that was found before, on the processor; None if there was none."""
        if key not in self._lines:
            return None
        known = json_object(self._lines[key], self.path, CorruptStore)
        vector, log_posterior, precision, information = map(_tensor, known["numbers"])
        return Optimum(
            vector,
            log_posterior,
            precision,
            information,
            torch.tensor([known["is_converged"]]),
            known["n_iterations"],
        )

    def add(self, key: str, optimum: Optimum) -> None:
        """Remember a maximum (one row)."""
        numbers = (optimum.vector, optimum.log_posterior, optimum.precision, optimum.information)
        line = sealed(
            {
                "key": key,
                "is_converged": bool(optimum.is_converged[0]),
                "n_iterations": optimum.n_iterations,
                "numbers": [_text(values) for values in numbers],
            }
        )
        self._lines[key] = line
        with self._writing:
            append_text(self.path, line)


@contextmanager
def remembering(folder: Path | None) -> Iterator[FitJournal | None]:
    """The journal in a folder; without a folder None, which remembers nothing. A folder that stays empty is removed."""
    if folder is None:
        yield None
        return
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield FitJournal(folder / FITS)
    finally:
        if is_new and not any(folder.iterdir()):
            folder.rmdir()


def key_of(
    rig: Rig,
    observations: Observations,
    start: Tensor,
    tolerance: float,
    rules: Mapping[str, Rule],
    place: tuple[torch.device, torch.dtype] | None,
) -> str:
    """What identifies a fit: code, rig, readings, starts, tolerance, quadrature rules, and the device and precision of its climb."""
    words = (str(code_version()), rig.hash, repr(tolerance), repr(sorted(rules.items())), str(place))
    digest = hashlib.sha256(" ".join(words).encode())
    for values in (observations.time_s, observations.row, observations.field_sensor_T, start):
        digest.update(numpy_of(values.contiguous()).tobytes())
    return digest.hexdigest()


def _text(values: Tensor) -> tuple[list[int], str]:
    array = numpy_of(values.to(torch.float64).contiguous())
    return list(array.shape), base64.b64encode(array.tobytes()).decode()


def _tensor(stored: tuple[list[int], str]) -> Tensor:
    shape, text = stored
    return torch.from_numpy(np.frombuffer(base64.b64decode(text), dtype=np.float64).reshape(shape).copy())

"""Files of a store, each damaged in turn and put back afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np


def files(folder: Path) -> list[Path]:
    """Every file below a folder."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def flipped(folder: Path, n_bits: int) -> Iterator[Path]:
    """Each file with one of its bits flipped, as many times as is asked for."""
    random = np.random.default_rng(0)
    for path in files(folder):
        content = path.read_bytes()
        for bit in random.choice(8 * len(content), n_bits, replace=False):
            damaged = bytearray(content)
            damaged[bit // 8] ^= 1 << (bit % 8)
            path.write_bytes(damaged)
            yield path
        path.write_bytes(content)


def lost(folder: Path) -> Iterator[Path]:
    """Each file while it is gone."""
    for path in files(folder):
        content = path.read_bytes()
        path.unlink()
        yield path
        path.write_bytes(content)


def cut(folder: Path) -> Iterator[Path]:
    """Each file empty, then half of it, then all but its last byte."""
    for path in files(folder):
        content = path.read_bytes()
        for length in (0, len(content) // 2, len(content) - 1):
            path.write_bytes(content[:length])
            yield path
        path.write_bytes(content)

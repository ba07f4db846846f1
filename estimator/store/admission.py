"""What a folder must be before zarr opens it, and its arrays before they become readings.

Zarr runs the codecs that an array asks for, allots the memory that its metadata claims and waits for whatever its files are, so the
metadata of a store that came from elsewhere are read here first, by plain JSON.

A zstd file says in its header how much memory it wants, and may hold any number of frames, each of which may unfold to thousands of times
its size. The decoder believes all of that, so the frames of a chunk are followed here from header to end,
without decoding them: decoded, a chunk must be as long as its array says.

References: RFC 8878, Zstandard Compression, sections 3.1.1 and 3.1.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from estimator.errors import CorruptStore
from estimator.given_files import read_given
from estimator.json_files import json_object
from estimator.rig.rig import Rig
from estimator.units import LARGEST

METADATA = "zarr.json"
CODECS = ("bytes", "zstd", "crc32c")  # in this order
TYPES = {"bool": 1, "int64": 8, "float64": 8}  # bytes of a number
KEYS = {"name": "default", "configuration": {"separator": "/"}}  # chunks are files such as c/0/1
MOST_FILES = 100_000
MOST_METADATA_BYTES = 8_000_000
MOST_NUMBERS = 300_000_000  # in all arrays, and in one chunk: 2.4 GB
FEW_NUMBERS = 20_000_000  # 160 MB, which a store may claim whatever it holds
# Numbers of a chunk for each byte: measured readings take more than a byte a number, zeros of many movers hardly any
MOST_PER_BYTE = 25
MOST_REPEATS = 999_999_999


def admit(path: Path, what: str, most_numbers: int = MOST_NUMBERS) -> None:
    """Refuse a folder of zarr that is not what coilcal writes.

    Args:
        path: Folder of the group.
        what: The kind of store, for messages.
        most_numbers: Numbers that all arrays together may hold.
    Raises:
        CorruptStore: It is of another zarr format, beyond a limit, or its metadata cannot be read.
    """
    n_numbers = n_stored = 0
    for n_files, part in enumerate(path.rglob("*"), start=1):
        if n_files > MOST_FILES:
            raise CorruptStore(f"{what} must hold at most {MOST_FILES} files; {path} holds more")
        if not part.is_file() and (part.is_symlink() or not part.is_dir()):
            raise CorruptStore(f"{what} must hold files and folders only; {part} is something else")
        if part.name in (".zgroup", ".zarray"):
            raise CorruptStore(f"{what} must be of zarr format 3; {part} is of format 2")
        if part.name == METADATA:
            n_numbers += _numbers_of(part, what)
            if n_numbers > most_numbers:
                raise CorruptStore(
                    f"{what} must hold at most {most_numbers} numbers; with {part} it claims {n_numbers}"
                )
        elif part.is_file():
            n_stored += part.stat().st_size
    if n_numbers > FEW_NUMBERS + MOST_PER_BYTE * n_stored:
        raise CorruptStore(
            f"{what} must hold the numbers that it claims; {path} claims {n_numbers} in {n_stored} bytes"
        )


def admit_readings(stored: Mapping[str, np.ndarray], rig: Rig, file: str) -> None:
    """Refuse arrays that are no readings of a rig: of other lengths or types, or with sensors that it has not.

    Args:
        stored: Arrays by name, as in a session.
        rig: The rig of the readings.
        file: Their origin, for messages.
    Raises:
        CorruptStore: An array is missing, or breaks the rule that the message names.
    """
    n = stored["time_s"].size if "time_s" in stored else 0
    shapes: dict[str, tuple[tuple[int, ...], str]] = {
        "time_s": ((n,), "float64"),
        "sensor_index": ((n,), "int64"),
        "current_A": ((n, len(rig.coils)), "float64"),
        "field_sensor_T": ((n, 3), "float64"),
        "is_validation": ((n,), "bool"),
        "repeat": ((n,), "int64"),
    }
    shapes |= {f"motion_{mover.name}": ((n, 6), "float64") for mover in rig.movers}
    shapes |= {name: ((n,), "float64") for name in stored if name.startswith("temperature_")}
    optional = {
        "current_measured_A": shapes["current_A"],
        "segment": shapes["repeat"],
        "line": shapes["repeat"],
    }
    shapes |= {name: rule for name, rule in optional.items() if name in stored}
    for name, (shape, kind) in shapes.items():
        if name not in stored:
            raise CorruptStore(f"readings must have the array {name}; it is missing ({file})")
        array = stored[name]
        if array.shape != shape or array.dtype != kind:
            raise CorruptStore(
                f"{name} must be {kind} of shape {shape}; received {array.dtype} of shape {array.shape} ({file})"
            )
        lowest, highest = {
            "sensor_index": (0, len(rig.sensors) - 1),
            "repeat": (0, MOST_REPEATS),
            "segment": (-1, MOST_REPEATS),
            "line": (0, MOST_REPEATS),
        }.get(name, (-LARGEST, LARGEST))
        beyond = array[(array < lowest) | (array > highest)]
        if beyond.size:
            raise CorruptStore(
                f"{name} must lie between {lowest:g} and {highest:g}; received {beyond[0]:g} ({file})"
            )


def _numbers_of(file: Path, what: str) -> int:
    """Numbers that a node of zarr claims to hold, after a look at its metadata and chunks; 0 for a group."""
    try:
        node = json_object(read_given(file, MOST_METADATA_BYTES, CorruptStore), file, CorruptStore)
        if node["zarr_format"] != 3:
            raise CorruptStore(f"{what} must be of zarr format 3; {file} is of {node['zarr_format']!r}")
        if node["node_type"] == "group":
            return 0
        codecs = [codec["name"] for codec in node["codecs"]]
        data_type = str(node["data_type"])
        keys = node["chunk_key_encoding"]
        n_of_array, n_of_chunk = (
            int(abs(math.prod(shape)))
            for shape in (node["shape"], node["chunk_grid"]["configuration"]["chunk_shape"])
        )
    except CorruptStore:
        raise
    except Exception as error:  # altered JSON raises errors of nearly any type
        raise CorruptStore(
            f"{what} must be readable; {file} is damaged: {type(error).__name__} {error}"
        ) from error
    if codecs != [codec for codec in CODECS if codec in codecs] or codecs[:1] != ["bytes"]:
        others = [str(codec)[:60] for codec in codecs if codec not in CODECS][:3]
        raise CorruptStore(
            f"{what} must use the codecs {', '.join(CODECS)} only, in this order; {file} uses {others or codecs[:9]}"
        )
    if data_type not in TYPES:
        raise CorruptStore(f"{what} must hold arrays of {', '.join(TYPES)}; {file} is of {data_type[:60]!r}")
    if keys != KEYS:
        raise CorruptStore(f"{what} must name its chunks by folders, as c/0/1; {file} names them otherwise")
    if n_of_chunk <= MOST_NUMBERS:
        for chunk in _chunks_of(file.parent):
            admit_chunk(chunk, n_of_chunk * TYPES[data_type], codecs, what)
    return max(n_of_array, n_of_chunk)


def _chunks_of(folder: Path) -> Iterator[Path]:
    """The files of an array that zarr reads as chunks."""
    for part in folder.rglob("*"):
        first, *indices = part.relative_to(folder).parts
        if first == "c" and all(index.isdecimal() for index in indices) and part.is_file():
            yield part


MAGIC = b"\x28\xb5\x2f\xfd"
RLE, RESERVED = 1, 3  # types of blocks: one byte repeated, and none
LARGEST_BLOCK = 128 * 1024
SMALLEST_BLOCK = 1024
"""Blocks of at least this size hold what an encoder writes, so that a frame of empty blocks is not followed for minutes."""


def admit_chunk(file: Path, n_bytes: int, codecs: Sequence[str], what: str) -> None:
    """Refuse a chunk that is not as long when decoded as its array says.

    Args:
        file: The chunk.
        n_bytes: Bytes of a whole chunk of its array.
        codecs: Names of its codecs, in the order in which they encode.
        what: The kind of store, for messages.
    Raises:
        CorruptStore: It is longer or shorter, or is no zstd frame.
    """
    n_after = 4 if "crc32c" in codecs else 0
    size = file.stat().st_size
    if "zstd" not in codecs:
        n_decoded: int | None = size - n_after
    elif size > n_bytes + n_bytes // 128 + 1024:  # more than any encoder needs
        n_decoded = None
    else:
        with file.open("rb") as stream:
            n_decoded = _decoded_size(stream, size - n_after, n_bytes)
    if n_decoded != n_bytes:
        raise CorruptStore(
            f"{what} must hold chunks of the size that its arrays have; {file} is no chunk of {n_bytes} bytes"
        )


def _decoded_size(stream: BinaryIO, end: int, most: int) -> int | None:
    """Bytes that the only frame of a file unfolds to, by its header; None if there is anything but one frame, or it does not say."""
    if stream.read(4) != MAGIC:
        return None
    descriptor = int.from_bytes(stream.read(1), "little")
    is_single_segment, has_checksum = bool(descriptor & 0x20), bool(descriptor & 0x04)
    n_size = (1 if is_single_segment else 0, 2, 4, 8)[descriptor >> 6]
    if n_size == 0:
        return None
    stream.read((0 if is_single_segment else 1) + (0, 1, 2, 4)[descriptor & 0x03])  # window and dictionary
    size = int.from_bytes(stream.read(n_size), "little") + (256 if n_size == 2 else 0)
    for _ in range(most // SMALLEST_BLOCK + 16):
        header = stream.read(3)
        block = int.from_bytes(header, "little")
        length, kind, is_last = block >> 3, block >> 1 & 0x03, bool(block & 1)
        if len(header) < 3 or kind == RESERVED or length > LARGEST_BLOCK:
            return None
        stream.seek(1 if kind == RLE else length, 1)
        if is_last:
            return size if stream.tell() + (4 if has_checksum else 0) == end else None
    return None

"""What a chunk of a zarr array must be before its codecs run: as long when decoded as its array says.

A zstd file says in its header how much memory it wants, and may hold any number of frames, each of which may unfold to thousands of times
its size. The decoder believes all of that, so the frame is followed here from header to end, without decoding it.

References: RFC 8878, Zstandard Compression, sections 3.1.1 and 3.1.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from estimator.errors import CorruptStore

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

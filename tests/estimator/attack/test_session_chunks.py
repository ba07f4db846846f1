"""Chunks that unfold to another size than their array has; the decoder alone would follow them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st
from numcodecs.zstd import Zstd

from estimator.errors import CorruptStore
from estimator.store.admission import LARGEST_BLOCK, MAGIC, admit_chunk
from estimator.store.session import load_session
from tests.estimator.attack.conftest import N, refusal, replace_array

pytestmark = pytest.mark.whole


def frame_of(data: bytes) -> bytes:
    return bytes(Zstd(level=3).encode(data))


def with_chunk(frame: bytes) -> Callable[[Path], None]:
    """A chunk with the right CRC-32C in place of the times, which are 36 numbers of 8 bytes."""

    def change(session: Path) -> None:
        content = frame + google_crc32c.value(frame).to_bytes(4, "little")
        (session / "time_s" / "c" / "0").write_bytes(content)

    return change


def sparse(session: Path) -> None:
    with (session / "time_s" / "c" / "0").open("wb") as file:
        file.truncate(1 << 40)


ONE = frame_of(b"\0" * 8 * N)
LARGE = frame_of(b"\0" * (1 << 26))
BLOCKS = [((LARGEST_BLOCK << 3) | 2 | (i == 99)).to_bytes(3, "little") + b"\0" for i in range(100)]
EMPTY_BLOCKS = b"\0\0\0" * 1000 + b"\1\0\0"
CHUNKS = {
    "64 MB": LARGE,
    "64 MB in a second frame": ONE + LARGE,
    "64 MB after an empty frame": frame_of(b"") + LARGE,
    "64 MB after a skipped frame": b"\x50\x2a\x4d\x18\4\0\0\0abcd" + LARGE,
    "13 MB in a frame that does not say so": MAGIC + b"\x00\x38" + b"".join(BLOCKS),
    "many empty blocks": MAGIC + b"\x60" + (8 * N - 256).to_bytes(2, "little") + EMPTY_BLOCKS,
    "too short": frame_of(b"\0" * 8),
    "half a frame": ONE[: len(ONE) // 2],
    "half a header": MAGIC,
    "no frame": b"\0" * 8 * N,
    "nothing": b"",
}


@pytest.mark.parametrize("frame", CHUNKS.values(), ids=CHUNKS)
def test_a_chunk_of_another_size_is_not_decoded(session, frame, monkeypatch):
    with_chunk(frame)(session)
    monkeypatch.setattr(zarr, "open_group", None)
    assert "must hold chunks of the size that its arrays have; " in refusal(load_session, session)


def test_a_chunk_of_a_terabyte_of_holes_is_not_read(session):
    sparse(session)
    assert "is no chunk of 288 bytes" in refusal(load_session, session)


def test_a_chunk_without_zstd_is_as_long_as_it_should_be(session):
    replace_array(session, "repeat", np.ones(N, int))
    load_session(session)
    with (session / "repeat" / "c" / "0").open("ab") as file:
        file.write(b"\0")
    assert "is no chunk of 288 bytes" in refusal(load_session, session)


@given(st.binary(max_size=60), st.booleans())
def test_any_bytes_are_one_frame_of_the_right_size_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, is_frame: bool
) -> None:
    """What is admitted is what the decoder makes of it."""
    file = tmp_path_factory.getbasetemp() / "any chunk"
    file.write_bytes(frame_of(data) if is_frame else MAGIC + data)
    try:
        admit_chunk(file, len(data), ["bytes", "zstd"], "session")
    except CorruptStore:
        assert not is_frame
    else:
        assert is_frame


@pytest.mark.parametrize("size", [0, 1, 255, 256, 257, 65_791, 65_792, 200_000, 3_000_000])
def test_frames_of_every_size_are_admitted(tmp_path, size):
    random = np.random.default_rng(size).bytes(size)
    for data in (random, b"\0" * size):
        (tmp_path / "chunk").write_bytes(frame_of(data))
        admit_chunk(tmp_path / "chunk", size, ["bytes", "zstd"], "session")
        with pytest.raises(CorruptStore):
            admit_chunk(tmp_path / "chunk", size + 1, ["bytes", "zstd"], "session")

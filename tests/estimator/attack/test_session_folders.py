"""Folders of sessions that zarr should not open: pipes, links, other formats, codecs and sizes."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from estimator.store.session import load_session
from tests.estimator.attack.conftest import refusal

pytestmark = pytest.mark.whole


def with_metadata(**changes: object) -> Callable[[Path], None]:
    def change(session: Path) -> None:
        file = session / "time_s" / "zarr.json"
        node = json.loads(file.read_text(encoding="utf-8"))
        file.write_text(json.dumps({**node, **changes}), encoding="utf-8")

    return change


def pipe_in_place_of(name: str) -> Callable[[Path], None]:
    def change(session: Path) -> None:
        (session / name).unlink(missing_ok=True)
        os.mkfifo(session / name)

    return change


def link_to_itself(session: Path) -> None:
    shutil.rmtree(session / "time_s")
    (session / "time_s").symlink_to(session)


FOLDERS = {
    "a pipe as chunk": (pipe_in_place_of("time_s/c/0"), "must hold files and folders only"),
    "a pipe as metadata": (pipe_in_place_of("time_s/zarr.json"), "must hold files and folders only"),
    "a pipe beside the arrays": (pipe_in_place_of("notes.txt"), "must hold files and folders only"),
    "a link to itself": (link_to_itself, "must hold files and folders only"),
    "format 2 beside format 3": (lambda s: (s / ".zgroup").write_text("{}"), "must be of zarr format 3"),
    "format 2 in the metadata": (with_metadata(zarr_format=2), "must be of zarr format 3"),
    "another codec": (with_metadata(codecs=[{"name": "numcodecs.zlib"}]), "must use the codecs bytes, zstd, crc32c only"),
    "codecs in another order": (
        with_metadata(codecs=[{"name": "bytes"}, {"name": "crc32c"}, {"name": "zstd"}]),
        "must use the codecs bytes, zstd, crc32c only, in this order",
    ),
    "zstd twice": (
        with_metadata(codecs=[{"name": "bytes"}, {"name": "zstd"}, {"name": "zstd"}]),
        "must use the codecs bytes, zstd, crc32c only, in this order",
    ),
    "chunks by other names": (
        with_metadata(chunk_key_encoding={"name": "v2", "configuration": {"separator": "."}}),
        "must name its chunks by folders",
    ),
    "pickle": (with_metadata(codecs=[{"name": "numcodecs.pickle"}]), "must use the codecs bytes, zstd, crc32c only"),
    "objects": (with_metadata(data_type="object"), "must hold arrays of bool, int64, float64; "),
    "1e13 numbers": (with_metadata(shape=[10**13]), "must hold at most 300000000 numbers"),
    "a chunk of 1e13": (
        with_metadata(chunk_grid={"name": "regular", "configuration": {"chunk_shape": [10**13]}}),
        "must hold at most 300000000 numbers",
    ),
    "deep metadata": (lambda s: (s / "time_s/zarr.json").write_text("[" * 100_000), "JSON of at most 100 levels"),
    "a list as metadata": (lambda s: (s / "time_s/zarr.json").write_text("[]"), "must hold a JSON object; it holds []"),
    "long metadata": (lambda s: (s / "zarr.json").write_text(" " * 8_000_001), "must hold at most 8000000 bytes"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), FOLDERS.values(), ids=FOLDERS)
def test_a_folder_is_looked_at_before_zarr_opens_it(session, change, message):
    change(session)
    assert message in refusal(load_session, session)


def test_a_store_that_claims_far_more_than_it_holds_is_refused_at_once(session):
    """Zarr reads chunks that are missing as zeros, and allots memory for all of them."""
    for file in session.glob("*/zarr.json"):
        node = json.loads(file.read_text(encoding="utf-8"))
        node["shape"][0] = 14_000_000
        file.write_text(json.dumps(node), encoding="utf-8")
    begin_s = time.process_time()
    assert "must hold the numbers that it claims" in refusal(load_session, session)
    assert time.process_time() - begin_s < 1.0

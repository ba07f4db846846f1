"""Whatever a user names as a file: read, or refused at once in one sentence, and never waited for."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from estimator import given_files
from estimator.cli.contents import contents_of
from estimator.cli.delivery import RECEIPT, Receipt
from estimator.cli.simulate import truth_of
from estimator.comparison.map_files import read_map
from estimator.errors import CoilcalError, CorruptStore, InvalidInput
from estimator.given_files import open_given, read_given, text_of
from estimator.readings.plan import load_plan
from estimator.rig.rig import Rig
from estimator.rig_files.arm_files import _links
from estimator.rig_files.read import load_rig
from estimator.service.settings import load_settings
from estimator.store.importers import IMPORTERS
from estimator.store.importers.forms.understand import understood


def pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


def bound(path: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as own:
        own.bind(os.path.relpath(path))  # the name of a socket is short
    return path


def folder(path: Path) -> Path:
    path.mkdir()
    return path


STRANGE: dict[str, tuple[Callable[[Path], Path], str]] = {
    "a named pipe": (pipe, "it is a named pipe"),
    "a device without end": (lambda _: Path("/dev/zero"), "it is a device"),
    "an empty device": (lambda _: Path("/dev/null"), "it is a device"),
    "a socket": (bound, "it is a socket"),
    "a folder": (folder, "Is a directory"),
    "nothing": (lambda path: path, "No such file or directory"),
}
READERS: dict[str, Callable[[Path, Rig], object]] = {
    "a rig": lambda path, _: load_rig(path),
    "a plan": load_plan,
    "a truth": lambda path, rig: truth_of(rig, str(path), 0),
    "settings": lambda path, _: load_settings(path, {}),
    "a field map": lambda path, _: read_map(path, 1.0),
    "factory corrections": lambda path, _: _links(path),
    **{
        f"readings as {kind}": (lambda path, rig, kind=kind: IMPORTERS[kind]([path], rig, {}))
        for kind in ("axis_scan", "mice")
    },
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize(("make", "words"), STRANGE.values(), ids=STRANGE)
def test_what_is_no_file_is_refused_at_once(tmp_path, monkeypatch, small_rig, read, make, words):
    monkeypatch.chdir(tmp_path)
    path = make(tmp_path / "given")
    begin_s = time.process_time()
    with pytest.raises(InvalidInput, match=words) as caught:
        read(path, small_rig)
    assert time.process_time() - begin_s < 5.0
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_check_and_show_name_it_too(tmp_path, small_rig):
    with pytest.raises(InvalidInput, match="it is a named pipe"):
        understood(pipe(tmp_path / "readings.csv"), small_rig)
    with pytest.raises(InvalidInput):
        contents_of(tmp_path / "readings.csv")


def test_a_pipe_that_takes_the_place_of_a_file_is_not_waited_for(tmp_path, monkeypatch):
    file, path = tmp_path / "file", pipe(tmp_path / "pipe")
    file.touch()
    there = file.stat()
    monkeypatch.setattr(Path, "stat", lambda self: there)
    with pytest.raises(InvalidInput, match="it is a named pipe"):
        open_given(path, 10)


def test_a_larger_file_is_not_read(tmp_path, monkeypatch):
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(10**12)  # holes, which take no space
    begin_s = time.process_time()
    for read in (read_given, open_given):
        with pytest.raises(CorruptStore, match="large must hold at most 1000 bytes; it holds more"):
            read(path, 1000, CorruptStore)
    with pytest.raises(InvalidInput, match="at most 4000000 bytes"):
        load_rig(path)
    assert time.process_time() - begin_s < 1.0
    path.write_bytes(b"x" * 1000)
    assert read_given(path, 1000) == b"x" * 1000
    monkeypatch.setattr(given_files.os, "fstat", lambda _: (tmp_path / "large").stat())
    with pytest.raises(InvalidInput, match="at most 999 bytes"):
        read_given(path, 999)


def test_a_path_with_a_nul_is_refused():
    with pytest.raises(InvalidInput, match="path must hold no NUL"):
        load_rig(Path("a\0b"))


@pytest.mark.parametrize(
    "content", ["a µ".encode("latin-1"), "a\nb".encode("utf-16"), b"\xff\xfe\x00\x01", b"a\n\x80"]
)
def test_another_encoding_is_one_sentence(content):
    with pytest.raises(InvalidInput, match="a.csv must be readable as text: .*save it in UTF-8"):
        text_of(content, "a.csv")


def test_a_byte_order_mark_is_no_part_of_the_text():
    assert text_of(b"\xef\xbb\xbfa", "a.csv") == "a"


def test_a_receipt_is_a_file(tmp_path):
    assert Receipt.load(tmp_path) is None
    Receipt("http://localhost", "key", "7").save(tmp_path)
    assert Receipt.load(tmp_path) == Receipt("http://localhost", "key", "7")
    (tmp_path / RECEIPT).unlink()
    os.mkfifo(tmp_path / RECEIPT)
    with pytest.raises(CoilcalError, match="it is a named pipe"):
        Receipt.load(tmp_path)

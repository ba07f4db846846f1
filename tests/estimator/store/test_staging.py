"""Outputs are made aside and moved into place as a whole, by one writer at a time; only what coilcal made is ever deleted."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from estimator.errors import DiskFull, InvalidInput
from estimator.store import stage
from estimator.store.files import append_text, write_text
from estimator.store.made import Made
from estimator.store.stage import MARK, OutputBusy
from estimator.store.staging import clear, only_writer, staged, write_output
from tests.estimator.store.interrupted import full_disk, killed_at_each_operation
from tests.program import PYTHON, launched

NOTES = Made("notes", r"note\d+\.txt", ("note1.txt",), lambda folder: (folder / "note1.txt").is_file())
BUSY = r"^output must be written by one program at a time; another writes .*/result$"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write_notes(output: Path, overwrite: bool = False, words: str = "new") -> None:
    with staged(output, overwrite, NOTES) as new:
        new.mkdir()
        for n in (1, 2):
            write_text(new / f"note{n}.txt", words)


def test_a_second_writer_is_refused_until_the_first_has_ended(tmp_path):
    for first, second in ((staged, staged), (only_writer, only_writer)):
        with first(tmp_path / "result"), pytest.raises(OutputBusy, match=BUSY), second(tmp_path / "result"):
            pytest.fail("both write")
        with first(tmp_path / "result"), staged(tmp_path / "other"), staged(tmp_path / "result.2"):
            pass
    assert names(tmp_path) == []


def test_a_writer_that_waits_comes_after_the_other(tmp_path):
    program = (
        "import sys, time\nfrom pathlib import Path\nfrom estimator.store.staging import staged\n"
        "with staged(sys.argv[1]) as new:\n    print('writes', flush=True)\n    time.sleep(0.5)\n    new.write_text('first')"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "result")],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parents[3],
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"writes\n"
        with (
            pytest.raises(InvalidInput, match="must not exist yet"),
            staged(tmp_path / "result", waits=True) as new,
        ):
            new.write_text("second")
    assert (tmp_path / "result").read_text() == "first"


def test_what_was_there_or_was_written_stays_and_an_empty_folder_does_not(tmp_path):
    with only_writer(tmp_path / "in" / "new"):
        pass
    assert not (tmp_path / "in" / "new").exists()
    with pytest.raises(ValueError), only_writer(tmp_path / "refused"):  # noqa: PT011 - any error
        raise ValueError
    assert not (tmp_path / "refused").exists()
    (tmp_path / "old").mkdir()
    with only_writer(tmp_path / "old"):
        pass
    assert (tmp_path / "old").exists()
    with only_writer(tmp_path / "full"):
        (tmp_path / "full" / "file").touch()
    assert names(tmp_path / "full") == ["file"]


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(InvalidInput, match=r"writable; .*/file/out is not: "),
        only_writer(tmp_path / "file" / "out"),
    ):
        pytest.fail("written")


def test_what_fails_leaves_nothing_and_what_was_there(tmp_path):
    with pytest.raises(ZeroDivisionError), staged(tmp_path / "a" / "b" / "result") as new:
        new.write_text(str(1 / len([])))
    assert names(tmp_path) == []
    write_notes(tmp_path / "notes", words="old")
    with pytest.raises(ZeroDivisionError), staged(tmp_path / "notes", True, NOTES) as new:  # noqa: PT012 - it is made first
        new.mkdir()
        (new / "note1.txt").write_text(str(1 / len([])))
    assert (tmp_path / "notes" / "note2.txt").read_text() == "old"
    assert names(tmp_path) == ["notes"]


def test_killed_at_any_file_operation_an_output_is_the_old_one_or_the_new_one(tmp_path):
    output = tmp_path / "notes"
    write_notes(output, words="old")
    met = set()
    for _ in killed_at_each_operation(lambda: write_notes(output, True)):
        contents = {path.read_text() for path in output.iterdir()}
        assert len(contents) == 1
        met |= contents
        if contents == {"new"}:
            write_notes(output, True, "old")
            assert names(tmp_path) == ["notes"]
    assert met == {"old", "new"}


def test_where_names_cannot_be_exchanged_a_killed_output_is_put_back(tmp_path, monkeypatch):
    monkeypatch.setattr("estimator.store.stage._renamed", lambda *_: False)
    output = tmp_path / "notes"
    write_notes(output, words="old")
    were_away = 0
    for _ in killed_at_each_operation(lambda: write_notes(output, True)):
        were_away += not output.exists()
        clear(output)
        contents = {path.read_text() for path in output.iterdir()}
        assert contents in ({"old"}, {"new"})
        if contents == {"new"}:
            write_notes(output, True, "old")
        assert names(tmp_path) == ["notes"]
    assert were_away == 1


def interrupted_after(part: Path) -> None:
    part.write_text("1")
    raise KeyboardInterrupt


def test_what_was_interrupted_goes_on_after_a_kill_and_after_an_error(tmp_path):
    output = tmp_path / "result"
    with pytest.raises(KeyboardInterrupt), staged(output, goes_on=True):
        raise KeyboardInterrupt
    assert names(tmp_path) == []
    with pytest.raises(KeyboardInterrupt), staged(output, goes_on=True) as new:  # noqa: PT012 - it must be made first
        new.mkdir()
        interrupted_after(new / "part")
    assert [name[:8] for name in names(tmp_path)] == [".result."]
    with staged(output, goes_on=True) as new:
        assert (new / "part").read_text() == "1"
        (new / "rest").write_text("2")
    assert names(tmp_path) == ["result"]
    assert names(output) == ["part", "rest"]


def test_a_disk_that_is_full_is_one_sentence_and_leaves_what_was_there(tmp_path):
    output = tmp_path / "notes"
    write_notes(output, words="old")
    for n in range(100):
        with full_disk(n) as disk:
            sentence = refusal(output)
        assert names(tmp_path) == ["notes"]
        if sentence is None:
            break
        assert disk.was_full
        assert {path.read_text() for path in output.iterdir()} == {"old"}
        assert sentence == (
            f"output must be writable; {output} is not: No space left on device; "
            "the disk that holds it is full: free some of it, or write to another"
        )
    assert n > 8
    assert {path.read_text() for path in output.iterdir()} == {"new"}


def refusal(output: Path) -> str | None:
    """What is said of a disk that is full; None where there was room."""
    try:
        write_notes(output, True)
    except DiskFull as error:
        return str(error)
    return None


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 KiB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no disk can be mounted here")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def test_a_real_disk_that_is_full_loses_nothing(small_disk):
    write_output(small_disk / "small", "old")
    for content in ("x" * 200_000, "x" * 66_000):
        for output, overwrite in (("large", False), ("small", True)):
            with pytest.raises(DiskFull, match=rf"/disk/{output} is not: No space left on device"):
                write_output(small_disk / output, content, overwrite)
        with pytest.raises(OSError, match="No space left") as fault:
            write_text(small_disk / "small", content)
        assert fault.value.filename == str(small_disk / "small")
        with pytest.raises(OSError, match="No space left"):
            append_text(small_disk / "small", content)
        assert (small_disk / "small").read_text() == "old"
        assert names(small_disk) == ["small"]


def test_nothing_of_others_is_followed_opened_or_replaced(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "notes.partial").symlink_to("precious")
    (tmp_path / "notes.old").mkdir()
    (tmp_path / "notes.old" / "file").write_text("precious")
    (tmp_path / ".notes.0123456789abcdef.coilcal").mkdir()
    (tmp_path / ".notes.0123456789abcdef.coilcal" / "file").write_text("precious")
    (tmp_path / ".notes.0123456789abcdee.coilcal").symlink_to("notes.old")
    empty, begun = (tmp_path / f".notes.0123456789abcdef0123456{digit}.coilcal" for digit in "78")
    empty.mkdir()
    begun.mkdir()
    (begun / "coilcal").touch()
    before = names(tmp_path)
    write_notes(tmp_path / "notes")
    write_notes(tmp_path / "notes", True)
    assert names(tmp_path) == sorted([*before, "notes"])
    assert (tmp_path / "precious").read_text() == "precious"
    assert (tmp_path / ".notes.0123456789abcdef.coilcal" / "file").read_text() == "precious"
    assert names(tmp_path / "notes.old") == ["file"]
    assert names(begun) == ["coilcal"]


@pytest.mark.parametrize("kind", ["link", "dangling link", "pipe", "folder", "other file"])
def test_what_is_no_folder_of_its_kind_is_not_replaced(tmp_path, kind):
    output = tmp_path / "notes"
    write_notes(tmp_path / "others")
    if kind == "link":
        output.symlink_to("others")
    elif kind == "dangling link":
        output.symlink_to("nowhere")
    elif kind == "pipe":
        os.mkfifo(output)
    elif kind == "folder":
        output.mkdir()
    else:
        write_notes(output)
        (output / "mine.txt").write_text("mine")
    before = os.lstat(output)
    with pytest.raises(InvalidInput) as fault:
        write_notes(output, True)
    if kind == "other file":
        assert "also holds mine.txt, which coilcal did not write" in str(fault.value)
    if kind != "other file":
        with pytest.raises(InvalidInput):
            write_output(output, "text", True)
        with pytest.raises(InvalidInput, match="must be a file"):
            write_text(output, "text")
    assert os.lstat(output) == before
    assert names(tmp_path) == ["notes", "others"]


def test_a_device_is_not_replaced():
    for write in (
        lambda: write_output("/dev/null", "text", True),
        lambda: write_text(Path("/dev/null"), "text"),
    ):
        with pytest.raises(InvalidInput, match="/dev/null is a device"):
            write()


RACE = """
import sys
from estimator.store.staging import staged
while not sys.stdin.read(1):
    pass
try:
    with staged(sys.argv[1], overwrite=True) as new:
        new.write_text(sys.argv[2] * 1000)
except Exception as error:
    print(error)
    sys.exit(2)
"""


def test_a_writer_that_ends_while_another_looks_is_none(tmp_path, monkeypatch):
    """Its folder is gone between the look at its kind and the look into it."""
    output = tmp_path / "result"
    folder = output.with_name(stage.unfinished_name(output.name))
    folder.mkdir()

    def gone(_: Path) -> str:
        if folder.exists():
            folder.rmdir()
        return "a folder"

    monkeypatch.setattr(stage, "kind_of", gone)
    assert stage.stages(output) == []


@pytest.mark.parametrize("n_writers", [2, 4])
def test_of_writers_that_race_each_writes_the_whole_or_says_why_not(tmp_path, n_writers):
    output = tmp_path / "result"
    n_refused = 0
    for _ in range(5):
        racers = [
            launched(PYTHON, "-c", RACE, output, letter, stdin=subprocess.PIPE)
            for letter in "abcd"[:n_writers]
        ]
        time.sleep(0.2)
        for racer in racers:
            assert racer.stdin is not None
            racer.stdin.write("g")
            racer.stdin.flush()
        ended = [(*racer.communicate(timeout=60), racer.returncode) for racer in racers]
        winners = [letter for letter, (_, _, code) in zip("abcd", ended, strict=False) if code == 0]
        for words, faults, code in ended:
            assert faults == ""
            assert (code, words.partition(";")[0]) in (
                (0, ""),
                (2, "output must be written by one program at a time"),
            )
            n_refused += code == 2
        content = output.read_text()
        assert content in {letter * 1000 for letter in winners}
        assert names(tmp_path) == ["result"]


def test_a_dead_writer_leaves_a_folder_without_a_lock(tmp_path):
    output = tmp_path / "result"
    child = os.fork()
    if child == 0:
        with staged(output) as new:
            new.write_text("half")
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".result.")
    assert "may be deleted" in (left / MARK).read_text()
    assert left.stat().st_mode & 0o777 == 0o700
    write_output(output, "whole")
    assert names(tmp_path) == ["result"]


def test_an_append_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    file = tmp_path / "lines"
    append_text(file, "first\n")
    write, n_written = os.write, 0

    def full(descriptor: int, content: bytes) -> int:
        nonlocal n_written
        if n_written:
            raise OSError(errno.ENOSPC, "No space left on device")
        n_written = write(descriptor, content[:3])
        return n_written

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space left"):
        append_text(file, "second")
    monkeypatch.undo()
    assert file.read_text() == "first\n"

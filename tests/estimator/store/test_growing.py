"""A growing session keeps all acknowledged entries after any crash, reports damage, and has one writer."""

from __future__ import annotations

import errno
import fcntl
import math
import os
import random
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from estimator.errors import CorruptStore, InvalidInput
from estimator.rig.rig import Rig
from estimator.store.growing import StopReadings, load_so_far, new_header
from estimator.store.journal import Journal, read_journal
from estimator.store.made import JOURNAL
from estimator.store.session import is_growing, load_session, remove_session, seal
from estimator.store.staging import staged

ROOT = Path(__file__).parents[3]


def stop(number: int, field_T: tuple[float, float, float] = (1e-3, 2e-3, 3e-3)) -> StopReadings:
    motion = {"arm1": [0.001 * number, 0.0, 0.0, 0.0, 0.0, 0.0]}
    return StopReadings(float(number), [3.0], motion, {"hall": field_T}, number % 2 == 1, 0, {"coil1": 2.999})


@pytest.fixture
def folder(tmp_path: Path, small_rig: Rig) -> Path:
    path = tmp_path / "session.zarr"
    with Journal.create(path, new_header(small_rig, "a test", "plan", {})) as journal:
        for number in range(3):
            journal.append(stop(number, (1e-3, math.nan, 3e-3)).entry())
    return path


def test_it_opens_while_it_grows_and_is_the_same_session_when_sealed(folder, small_rig):
    assert is_growing(folder)
    growing = load_session(folder)
    assert (growing.rig.hash, growing.source, len(growing.observations)) == (small_rig.hash, "a test", 3)
    with Journal.resume(folder) as journal:
        journal.append(stop(3).entry())
        sealed = seal(folder)
    assert not is_growing(folder)
    again = load_session(folder)
    assert again.hash == sealed.hash != growing.hash
    assert again.observations.is_validation.tolist() == [False, True, False, True]
    assert again.observations.motion["arm1"][:, 0].tolist() == [0.0, 0.001, 0.002, 0.003]
    assert torch.isnan(again.observations.field_sensor_T).sum() == 3
    assert read_journal(folder)[1][0]["measured_A"] == {"coil1": 2.999}


def test_the_history_of_the_currents_follows_from_the_journal():
    def between(begin_s: float, end_s: float, *current_A: float) -> StopReadings:
        return StopReadings(end_s - 0.5, current_A, {}, {}, False, 0, begin_s=begin_s, end_s=end_s)

    stops = [between(1.0, 4.0, 3.0, 0.0), between(4.0, 6.0, -2.0, 1.0), between(100.0, 102.0, 0.0, -5.0)]
    intervals = load_so_far([stop.entry() for stop in stops], ["a", "b"], 103.0)
    # No current before the first stop; up to 3 s more after the second, where a run ended; 1 s more after the last.
    seconds = [1.0, 3.0, 2.0, 3.0, 91.0, 2.0, 1.0]
    assert intervals == {
        "a": list(zip(seconds, [0.0, 3.0, 3.0, 3.0, 0.0, 0.0, 3.0], strict=True)),
        "b": list(zip(seconds, [0.0, 0.0, 1.0, 1.0, 0.0, 5.0, 5.0], strict=True)),
    }
    assert load_so_far([], ["a"], 7.0) == {"a": [(7.0, 0.0)]}


def test_the_load_of_a_journal_without_begin_and_end_of_stops_counts_from_reading_to_reading():
    entries = [{"time_s": 2.0, "current_A": [1.0]}, {"time_s": 5.0, "current_A": [-2.0]}]
    assert load_so_far(entries, ["a"], 5.0) == {"a": [(2.0, 1.0), (3.0, 2.0)]}


def test_a_torn_last_line_is_dropped_and_the_next_goes_in_its_place(folder):
    path = folder / JOURNAL
    whole = path.read_bytes()
    last = whole.rstrip(b"\n").rfind(b"\n") + 1
    for cut in (*range(last, len(whole) - 9, 7), *range(len(whole) - 9, len(whole) - 1)):
        path.write_bytes(whole[:cut])
        assert len(load_session(folder).observations) == 2
    with Journal.resume(folder) as journal:
        journal.append(stop(2, (1e-3, math.nan, 3e-3)).entry())
    assert path.read_bytes() == whole


def test_a_last_line_without_its_line_feed_is_whole(folder):
    path = folder / JOURNAL
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert len(load_session(folder).observations) == 3
    with Journal.resume(folder):
        assert path.read_bytes() == whole


def test_a_flipped_bit_anywhere_is_found(folder):
    path = folder / JOURNAL
    whole = path.read_bytes()
    draw = random.Random(1)
    for index in (*range(len(whole) - 8, len(whole)), *(draw.randrange(len(whole)) for _ in range(200))):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << draw.randrange(8)
        path.write_bytes(flipped)
        with pytest.raises(CorruptStore):
            load_session(folder)


def test_a_line_that_is_missing_or_doubled_is_found(folder):
    path = folder / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    for changed in ([lines[0], *lines[2:]], [*lines, lines[-1]], lines[1:], []):
        path.write_bytes(b"".join(changed))
        with pytest.raises(CorruptStore):
            load_session(folder)


def test_a_second_writer_is_refused_and_may_write_after_the_first(folder):
    with Journal.resume(folder), pytest.raises(InvalidInput, match="one process at a time"):
        Journal.resume(folder)
    Journal.resume(folder).close()


def test_a_full_disk_is_one_sentence_and_leaves_what_was_there(folder, monkeypatch):
    whole = (folder / JOURNAL).read_bytes()
    write = os.pwrite

    def full(descriptor: int, data: bytes, offset: int) -> int:
        if len(data) > 20:
            return write(descriptor, data[:20], offset)
        raise OSError(errno.ENOSPC, "No space left on device")

    with Journal.resume(folder) as journal:
        monkeypatch.setattr(
            os, "pwrite", lambda descriptor, data, offset: full(descriptor, data[:40], offset)
        )
        with pytest.raises(InvalidInput, match=r"session.zarr is not: No space left on device"):
            journal.append(stop(3).entry())
        monkeypatch.undo()
        assert (folder / JOURNAL).read_bytes() == whole
        journal.append(stop(3).entry())
    assert len(load_session(folder).observations) == 4


def test_a_disk_that_takes_nothing_and_gives_nothing_back_ends_the_writing_in_one_sentence(
    folder, monkeypatch
):
    def refuse(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with Journal.resume(folder) as journal:
        monkeypatch.setattr(os, "fsync", refuse)
        monkeypatch.setattr(os, "ftruncate", refuse)
        with pytest.raises(InvalidInput, match=r"session.zarr is not: Input/output error"):
            journal.append(stop(3).entry())
        monkeypatch.undo()
        with pytest.raises(InvalidInput, match="must be writable"):
            journal.append(stop(4).entry())  # would begin where the lost line is
    with Journal.resume(folder) as journal:
        assert [entry["time_s"] for entry in journal.entries] == [
            0.0,
            1.0,
            2.0,
            3.0,
        ]  # the line was complete after all


@pytest.mark.parametrize("n_writes", [0, 3, 12])
def test_a_disk_that_fills_up_while_a_session_is_sealed_leaves_the_journal(folder, monkeypatch, n_writes):
    n_left = n_writes
    opened = Path.open

    def full(self: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        nonlocal n_left
        if set(mode) & set("wxa+"):
            if not n_left:
                raise OSError(errno.ENOSPC, "No space left on device")
            n_left -= 1
        return opened(self, mode, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with pytest.raises(InvalidInput, match=r"session.zarr is not: No space left on device"):
            seal(folder)
    assert is_growing(folder)
    assert len(load_session(folder).observations) == 3
    assert seal(folder).hash == load_session(folder).hash


@pytest.mark.parametrize("number", [math.inf, -math.inf, 1e300, -1.1e12])
@pytest.mark.parametrize(
    "key", ["time_s", "current_A", "motion", "field_T", "measured_A", "temperature_C", "sd_T"]
)
def test_a_number_that_would_not_open_again_is_no_entry(key, number):
    shapes = {"time_s": number, "current_A": [number], "motion": {"arm1": [number] * 6}}
    spoilt = shapes.get(key, {"hall": [number] * 3} if key.endswith("_T") else {"hall": number})
    with pytest.raises(InvalidInput, match=f"{key} of a reading must hold numbers between"):
        replace(stop(1), **{key: spoilt}).entry()


def test_a_journal_that_cannot_begin_leaves_nothing(tmp_path, monkeypatch):
    """Neither on a full disk, which takes a part of the header, nor with a pose of an arm that is infinite."""

    def full(descriptor: int, data: bytes, offset: int) -> int:
        if offset:
            raise OSError(errno.ENOSPC, "No space left on device")
        return os.write(descriptor, data[:20])

    folder = tmp_path / "new" / "session.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(InvalidInput, match=r"session.zarr is not: No space left on device"):
            Journal.create(folder, {"kind": "test"})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InvalidInput, match="session must hold finite numbers"):
        Journal.create(folder, {"references": {"arm1": [math.inf]}})
    assert list(tmp_path.iterdir()) == []


def write_until_killed(folder: Path, acknowledge: int) -> None:
    """Main function of a process that acknowledges each entry once it is written."""
    try:
        with Journal.resume(folder) as journal:
            while True:
                journal.append({"value": len(journal.entries)})
                os.write(acknowledge, b"%d\n" % len(journal.entries))
    finally:
        os._exit(1)


def test_killed_at_50_random_instants_nothing_acknowledged_is_lost_or_doubled(tmp_path):
    folder = tmp_path / "session.zarr"
    Journal.create(folder, {"kind": "test"}).close()
    draw = random.Random(2)
    for _ in range(50):
        acknowledged, acknowledge = os.pipe()
        writer = os.fork()
        if writer == 0:
            write_until_killed(folder, acknowledge)
        os.close(acknowledge)
        time.sleep(0.03 * draw.random())
        os.kill(writer, signal.SIGKILL)
        os.waitpid(writer, 0)
        with os.fdopen(acknowledged, encoding="ascii") as pipe:
            numbers = [int(line) for line in pipe.read().split("\n")[:-1]]
        values = [entry["value"] for entry in read_journal(folder)[1]]
        assert values == list(range(len(values)))
        assert len(values) >= max(numbers, default=0)
    assert len(values) > 50


def test_killed_between_any_two_renames_a_session_being_sealed_is_a_journal_or_whole(folder, monkeypatch):
    class Killed(BaseException):
        pass

    rename, hashes = Path.rename, set()

    def killed_after(n_renames: int) -> bool:
        n_left = n_renames

        def until_killed(self: Path, target: Path) -> Path:
            nonlocal n_left
            if not n_left:
                raise Killed
            n_left -= 1
            return rename(self, target)

        monkeypatch.setattr(Path, "rename", until_killed)
        try:
            seal(folder)
        except Killed:
            return True
        finally:
            monkeypatch.undo()
        return False

    n_renames = 0
    while killed_after(n_renames):
        assert is_growing(folder)
        hashes.add(load_session(folder).hash)
        n_renames += 1
    assert n_renames > 5
    assert not is_growing(folder)
    assert hashes == {load_session(folder).hash}
    assert len(read_journal(folder)[1]) == 3


@pytest.mark.parametrize("how", ["removed", "replaced"])
def test_a_session_that_a_process_writes_is_not_removed(folder, small_session, how):
    def remove() -> None:
        if how == "removed":
            remove_session(folder)
        else:
            small_session.save(folder, overwrite=True)

    with Journal.resume(folder) as journal:
        with pytest.raises(InvalidInput, match=r"one process at a time; another writes .*session\.zarr$"):
            remove()
        journal.append(stop(3).entry())
    assert len(read_journal(folder)[1]) == 4
    remove()
    assert not is_growing(folder)


def test_a_writer_of_a_journal_that_was_removed_before_the_lock_is_refused(folder, monkeypatch):
    flock = fcntl.flock

    def late(descriptor: int, how: int) -> None:
        monkeypatch.undo()
        remove_session(folder)
        flock(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(InvalidInput, match="was removed"):
        Journal.resume(folder)


def test_a_session_that_another_process_begins_is_not_begun_again(tmp_path):
    path = tmp_path / "session.zarr"
    with (
        staged(path),
        pytest.raises(InvalidInput, match=r"one program at a time; another writes .*session\.zarr$"),
    ):
        Journal.create(path, {"kind": "test"})
    Journal.create(path, {"kind": "test"}).close()

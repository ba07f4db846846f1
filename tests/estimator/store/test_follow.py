"""A reader of a growing session gets every entry once and in order, whenever it reads."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from estimator.errors import CorruptStore, InvalidInput
from estimator.rig.rig import Rig
from estimator.store.follow import Follower
from estimator.store.growing import new_header
from estimator.store.journal import JOURNAL, Journal
from estimator.store.session import seal
from tests.estimator.store.test_growing import stop


@pytest.fixture
def folder(tmp_path: Path, small_rig: Rig) -> Path:
    path = tmp_path / "session.zarr"
    Journal.create(path, new_header(small_rig, "a test", "plan", {}, 7)).close()
    return path


def test_every_entry_is_returned_once_while_another_thread_writes(folder, small_rig):
    follower = Follower(folder)
    assert (follower.rig.hash, follower.header["n_stops"]) == (small_rig.hash, 7)

    def write() -> None:
        with Journal.resume(folder) as journal:
            for number in range(100):
                journal.append(stop(number).entry())
        seal(folder)

    writer = threading.Thread(target=write)
    writer.start()
    times = []
    while not (has_ended := follower.has_ended) or not writer.is_alive():
        times += [entry["time_s"] for entry in follower.entries()]
        if has_ended:
            break
    writer.join()
    assert times == list(range(100))
    assert follower.n_read == 100
    assert Follower(folder).entries()[-1]["time_s"] == 99.0  # also of a complete session


def test_half_a_line_waits_for_its_other_half(folder):
    follower = Follower(folder)
    with Journal.resume(folder) as journal:
        journal.append(stop(0).entry())
    whole = (folder / JOURNAL).read_bytes()
    for n_missing in (9, 1):
        (folder / JOURNAL).write_bytes(whole[:-n_missing])
        assert follower.entries() == []
    (folder / JOURNAL).write_bytes(whole)
    assert len(follower.entries()) == 1
    assert follower.entries() == []


def test_damage_is_found_when_it_is_read(folder):
    follower = Follower(folder)
    with Journal.resume(folder) as journal:
        journal.append(stop(0).entry())
    data = bytearray((folder / JOURNAL).read_bytes())
    data[-20] ^= 1
    (folder / JOURNAL).write_bytes(data)
    with pytest.raises(CorruptStore, match="line 2 of"):
        follower.entries()


def test_what_has_no_journal_cannot_be_followed(tmp_path):
    with pytest.raises(InvalidInput, match="which has no journal"):
        Follower(tmp_path)

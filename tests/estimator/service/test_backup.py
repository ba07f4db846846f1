"""A backup of a service that works holds what was acknowledged before, is whole or refused, and never overwrites."""

from __future__ import annotations

import hashlib
import io
import json
import os
import sqlite3
import tarfile
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner, Result
from starlette.testclient import TestClient

from estimator.cli.main import main
from estimator.errors import CoilcalError, CorruptStore, InvalidInput
from estimator.service.app import create_app
from estimator.service.backup import backup, restore
from estimator.service.settings import Settings
from estimator.store.files import unfinished_name
from tests.estimator.service.conftest import (
    append,
    begin_session,
    import_csv,
    numbered,
    upload_rig,
)


def serving(data: Path) -> Any:
    """A service on a folder, as it starts after a restore."""
    return TestClient(create_app(Settings(data=data), has_workers=False), base_url="http://127.0.0.1:8765")


def test_a_backup_of_a_service_that_takes_readings_holds_those_that_were_acknowledged(
    idle, rig_text, readings_csv, small_session, small_rig, tmp_path
):
    client = idle()
    rig_id = upload_rig(client, rig_text)
    imported = import_csv(client, rig_id, readings_csv)
    session_id = begin_session(client, rig_id)
    lines = numbered(small_session, small_rig, 2000)
    job = client.post("/v1/jobs/calibrate", json={"session_id": imported["id"]}).json()
    acknowledged, end = [0], threading.Event()

    def send() -> None:
        for first in range(0, len(lines), 5):
            answer = append(client, session_id, b"".join(lines[first : first + 5]))
            acknowledged[0] = answer.json()["n_readings"]
            if end.is_set():
                return

    sender = threading.Thread(target=send)
    sender.start()
    counts = []
    for number in range(3):
        while acknowledged[0] < 20 * (number + 1):
            pass
        before = acknowledged[0]
        backup(tmp_path / "data", tmp_path / f"{number}.tar")
        counts.append((before, acknowledged[0]))
    end.set()
    sender.join()
    for number, (before, after) in enumerate(counts):
        data = tmp_path / f"restored{number}"
        restore(tmp_path / f"{number}.tar", data)
        with serving(data) as other:
            n = other.get(f"/v1/sessions/{session_id}").json()["n_readings"]
            assert before <= n <= after + 5
            assert other.get(f"/v1/sessions/{imported['id']}/session.zip").status_code == 200
            assert other.get(f"/v1/jobs/{job['id']}").json()["state"] == "queued"
            assert append(other, session_id, b"".join(lines[: n + 10])).json() == {
                "n_readings": n + 10,
                "n_new": 10,
            }
            assert other.post(f"/v1/sessions/{session_id}/close").json()["n_readings"] == n + 10
    assert (data.stat().st_mode & 0o777, (tmp_path / "0.tar").stat().st_mode & 0o777) == (0o700, 0o600)


BEGUN = unfinished_name("a.zarr")  # what a kill left of a session that was being written


@pytest.fixture
def data(filled: Callable[..., tuple[TestClient, str]], tmp_path: Path) -> Path:
    """A data folder that is served, with things that a kill or a job may have left."""
    _, session_id = filled()
    folder = tmp_path / "data" / "sessions"
    (folder / BEGUN).mkdir()
    (folder / BEGUN / "journal.jsonl").write_bytes(b"x")
    sealing = folder / f"{session_id}.zarr" / unfinished_name("arrays")
    sealing.mkdir()
    job = tmp_path / "data" / "jobs" / "j"
    (job / "versions" / "0001").mkdir(parents=True)
    (job / "versions" / "0001" / "zarr.json").write_text("{}", encoding="utf-8")
    (job / "current").symlink_to("versions/0001")
    (job / "session.zarr").symlink_to(folder / f"{session_id}.zarr")  # as a recalibration has it
    (job / "outside").symlink_to("/etc/passwd")
    return tmp_path / "data"


def test_a_restored_folder_is_the_same_without_what_was_unfinished(data, tmp_path):
    told = backup(data, tmp_path / "b.tar")
    restored = restore(tmp_path / "b.tar", tmp_path / "restored")
    assert told["files"] == restored["files"]
    assert (tmp_path / "restored" / "jobs" / "j" / "current" / "zarr.json").read_text() == "{}"
    linked = tmp_path / "restored" / "jobs" / "j" / "session.zarr"
    assert linked.resolve().is_relative_to(tmp_path / "restored" / "sessions")
    assert (linked / "zarr.json").is_file()
    assert not (tmp_path / "restored" / "jobs" / "j" / "outside").is_symlink()
    assert not (tmp_path / "restored" / "sessions" / BEGUN).exists()
    assert (data / "page.key").is_file()
    assert not (tmp_path / "restored" / "page.key").exists()
    assert (data / "page.key").read_bytes() not in (tmp_path / "b.tar").read_bytes()
    for path in (tmp_path / "restored").rglob("*"):
        if path.is_file() and path.suffix != ".sqlite":
            assert path.read_bytes() == (data / path.relative_to(tmp_path / "restored")).read_bytes()
    kept = {path.relative_to(data) for path in (data / "sessions").rglob("*.json")}
    assert kept == {
        p.relative_to(tmp_path / "restored") for p in (tmp_path / "restored" / "sessions").rglob("*.json")
    }


def test_a_job_of_a_restored_folder_works_in_that_folder(filled, tmp_path):
    """It had begun before the backup, so its folder tells the paths of the old one."""
    client, session_id = filled()
    client.post("/v1/jobs/recalibrate", json={"session_id": session_id})
    client.app.state.core.jobs._look(Idle())
    backup(tmp_path / "data", tmp_path / "b.tar")
    restore(tmp_path / "b.tar", tmp_path / "restored")
    with serving(tmp_path / "restored") as other:
        other.app.state.core.queue.take_back()
        other.app.state.core.jobs._look(Idle())
        (job,) = (tmp_path / "restored" / "jobs").glob("*/job.json")
    assert str(tmp_path / "restored" / "registries") in job.read_text(encoding="utf-8")
    assert f"{tmp_path / 'data'}/" not in job.read_text(encoding="utf-8")


class Idle:
    """Stands for workers that begin nothing."""

    def start(self, call: Any, on_end: Callable[[], None]) -> Any:
        return SimpleNamespace(status="pending")


def test_nothing_is_overwritten(data, tmp_path):
    backup(data, tmp_path / "b.tar")
    with pytest.raises(InvalidInput, match="output must not exist yet"):
        backup(data, tmp_path / "b.tar")
    with pytest.raises(InvalidInput, match="must be a folder that does not exist yet"):
        restore(tmp_path / "b.tar", data)
    (tmp_path / "empty").mkdir()
    restore(tmp_path / "b.tar", tmp_path / "empty")
    with pytest.raises(InvalidInput, match="must be the folder of a service"):
        backup(tmp_path / "nothing", tmp_path / "c.tar")
    with pytest.raises(InvalidInput, match="must be a file that can be read"):
        restore(tmp_path / "c.tar", tmp_path / "other")
    with pytest.raises(InvalidInput, match="must be writable"):
        backup(data, tmp_path / "no folder" / "c.tar")
    with pytest.raises(InvalidInput, match="must be a file that can be read"):
        restore(tmp_path, tmp_path / "other")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InvalidInput, match="must be a file that can be read"):
        restore(tmp_path / "pipe", tmp_path / "other")
    (tmp_path / "link.tar").symlink_to(tmp_path / "nowhere.tar")
    with pytest.raises(InvalidInput, match="output must not exist yet"):
        backup(data, tmp_path / "link.tar")
    assert not (tmp_path / "other").exists()


def test_names_that_look_like_temporary_ones_belong_to_their_owner(data, tmp_path):
    """A folder of this name was deleted, and a file of this name overwritten, through a link even."""
    mine, target = tmp_path / "restored.restoring", tmp_path / "target"
    mine.mkdir()
    (mine / "thesis.txt").write_text("mine", encoding="utf-8")
    target.write_text("mine", encoding="utf-8")
    (tmp_path / "b.tar.partial").symlink_to(target)
    backup(data, tmp_path / "b.tar")
    restore(tmp_path / "b.tar", tmp_path / "restored")
    assert (mine / "thesis.txt").read_text(encoding="utf-8") == target.read_text(encoding="utf-8") == "mine"
    assert (tmp_path / "b.tar.partial").is_symlink()
    assert not list(tmp_path.glob(".*"))


def made_by_hand(manifest: object, checksums: object, *members: tuple[tarfile.TarInfo, bytes]) -> bytes:
    """A tar file in which everything may be wrong."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name, content in (("manifest.json", manifest), ("checksums.json", checksums)):
            text = content if isinstance(content, bytes) else json.dumps(content).encode()
            member = tarfile.TarInfo(name)
            member.size = len(text)
            archive.addfile(member, io.BytesIO(text))
        for member, content in members:
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return buffer.getvalue()


RIGHT = {"kind": "coilcal backup", "schema_version": 1, "created": "2026"}
FILE = "data/coilcal.sqlite"


def hashed(content: bytes) -> dict[str, str]:
    return {FILE: hashlib.sha256(content).hexdigest()}


def foreign(path: Path) -> bytes:
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE recipes (name TEXT)")
    return path.read_bytes()


def test_backups_that_were_made_by_hand_are_refused_in_one_sentence(tmp_path):
    other = foreign(tmp_path / "other.sqlite")
    torn = other[:5000] + b"\xff" * 3000
    late = tarfile.TarInfo("data/late")
    late.mtime = 1e300  # type: ignore[assignment]
    cases = {
        "no object": made_by_hand([], {}),
        "checksums in a list": made_by_hand(RIGHT, [FILE]),
        "numbers as checksums": made_by_hand(RIGHT, {FILE: 1}, (tarfile.TarInfo(FILE), b"x")),
        "depth": made_by_hand(b"[" * 100_000, {}),
        "not UTF-8": made_by_hand(b"\xff", {}),
        "a time beyond all": made_by_hand(RIGHT, hashed(b""), (tarfile.TarInfo(FILE), b""), (late, b"x")),
        "a file in a file": made_by_hand(RIGHT, hashed(b"x"), (tarfile.TarInfo("data"), b"x"), (tarfile.TarInfo(FILE), b"x")),
        "another program's database": made_by_hand(RIGHT, hashed(other), (tarfile.TarInfo(FILE), other)),
        "a damaged database": made_by_hand(RIGHT, hashed(torn), (tarfile.TarInfo(FILE), torn)),
        "words as a database": made_by_hand(RIGHT, hashed(b"words"), (tarfile.TarInfo(FILE), b"words")),
    }  # fmt: skip
    for name, content in cases.items():
        (tmp_path / "b.tar").write_bytes(content)
        result = run("restore", tmp_path / "b.tar", "--data", tmp_path / "restored")
        assert (result.exit_code, len(result.stderr.splitlines())) == (3, 1), (name, result.stderr)
        assert not isinstance(result.exception, Exception), name
        assert not (tmp_path / "restored").exists(), name
        assert not list(tmp_path.glob(".*")), name


def with_member(name: str, kind: bytes = tarfile.REGTYPE, link: str = "") -> bytes:
    """A backup with one more member."""
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, link
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.addfile(member)
    return buffer.getvalue()[: -2 * tarfile.BLOCKSIZE].rstrip(b"\0").ljust(tarfile.BLOCKSIZE, b"\0")


def test_damage_and_other_files_are_refused_and_leave_nothing(data, tmp_path):
    backup(data, tmp_path / "b.tar")
    good = (tmp_path / "b.tar").read_bytes()
    position = good.index(b"SQLite format 3") + 5000
    damaged = {
        "a flipped bit": good[:position] + bytes([good[position] ^ 1]) + good[position + 1 :],
        "half of it": good[: len(good) // 2],
        "the beginning": good[:1000],
        "nothing": b"",
        "words": b"hello" * 1000,
        "a path that leads out": with_member("../outside") + good,
        "a path from the root": with_member("/tmp/coilcal-outside") + good,
        "a link that leads out": with_member("data/link", tarfile.SYMTYPE, "../../outside") + good,
        "a pipe": with_member("data/pipe", tarfile.FIFOTYPE) + good,
        "one file more": with_member("data/jobs/more") + good,
        "another kind": good.replace(b'"coilcal backup"', b'"coilcal lookup"'),
    }
    for name, content in damaged.items():
        (tmp_path / "damaged.tar").write_bytes(content)
        with pytest.raises(CoilcalError) as caught:
            restore(tmp_path / "damaged.tar", tmp_path / "other")
        assert isinstance(caught.value, CorruptStore), (name, str(caught.value))
        assert not (tmp_path / "other").exists(), name
        assert not list(tmp_path.glob(".*")), name
        assert not (tmp_path / "outside").exists(), name


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["serve", *map(str, words)])


def test_the_commands_say_what_they_did(data, tmp_path):
    made = run("backup", tmp_path / "b.tar", "--data", data, "--json")
    assert made.exit_code == 0, made.stderr
    assert json.loads(made.stdout)["bytes"] == (tmp_path / "b.tar").stat().st_size
    again = run("backup", tmp_path / "b.tar", "--data", data)
    assert (again.exit_code, again.stdout) == (2, "")
    restored = run("restore", tmp_path / "b.tar", "--data", tmp_path / "restored")
    assert restored.exit_code == 0, restored.stderr
    assert "restored to" in restored.stdout
    assert run("restore", tmp_path / "b.tar", "--data", tmp_path / "restored").exit_code == 2
    (tmp_path / "no.tar").write_bytes(b"no backup")
    assert run("restore", tmp_path / "no.tar", "--data", tmp_path / "other").exit_code == 3

"""The registry keeps every version, swaps the current one whole, and completes what a kill left."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.calibration.result import Calibration
from estimator.errors import CoilcalError, CorruptStore, InvalidInput
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry
from estimator.rig_files.read import load_rig
from tests.program import PYTHON, finished

KILLS = """
import json, os, signal, sys, shutil
from collections.abc import Callable
from pathlib import Path
from estimator.calibration.result import Calibration
from estimator.recalibration.log import Entry, Log
from estimator.recalibration.registry import Registry
from estimator.rig_files.read import load_rig

kept, work = Path(sys.argv[1]), Path(sys.argv[2])
successor = Calibration.load(kept / "versions/0001")

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

def torn(self, entry):
    with self.path.open("a") as file:
        file.write(entry.line()[:40])
    die()

def after(method):
    def run(self, *arguments):
        method(self, *arguments)
        die()
    return run

replaced = {
    "before saving": (Registry, "_save", die),
    "after saving": (Registry, "_save", after(Registry._save)),
    "in the log": (Log, "append", torn),
    "after the log": (Log, "append", after(Log.append)),
    "after all": (Registry, "_point", after(Registry._point)),
}
for name, (owner, method, how) in replaced.items():
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(kept, work, symlinks=True)
    child = os.fork()
    if child == 0:
        registry = Registry(work)
        with registry.writing():
            setattr(owner, method, how)
            registry.commit(Entry("updated", "again", "b.zarr", "hash b"), successor)
    _, status = os.waitpid(child, 0)
    registry = Registry(work)
    left = registry.calibration().summary()["seed"]
    with registry.writing():
        pass
    entries = registry.entries()
    print(json.dumps([name, os.WTERMSIG(status), left, registry.versions, registry.current, [e.hash for e in entries]]))
"""


@pytest.fixture(scope="module")
def kept(small_calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("registry") / "kept"
    registry = Registry(folder)
    with registry.writing():
        registry.commit(
            Entry("updated", "first", "a.zarr", "hash a", "2026-01-01T00:00:00+00:00"), small_calibration
        )
    return folder


@pytest.fixture
def registry(kept: Path, tmp_path: Path) -> Registry:
    return Registry(shutil.copytree(kept, tmp_path / "kept", symlinks=True))


def test_a_version_is_whole_with_its_rig_and_provenance(registry, small_calibration):
    folder = registry.folder / "current"
    assert folder.readlink() == Path("versions/0001")
    assert np.array_equal(
        registry.calibration().draws["coil1.radius_m"], small_calibration.draws["coil1.radius_m"]
    )
    assert load_rig(folder / "rig.yaml") == small_calibration.rig
    provenance = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    assert provenance["previous"] is None
    assert provenance["rig_hash"] == small_calibration.rig.hash
    assert provenance["entry"]["session"] == "a.zarr"
    assert "posterior" in registry.tree().children


def test_a_conclusion_without_a_calibration_leaves_the_current_version(registry):
    with registry.writing():
        entry = registry.commit(Entry("rejected", "bad", "b.zarr", "hash b"))
    assert (entry.version, entry.made) == (1, None)
    assert registry.versions == (1,)
    assert [one.hash for one in registry.entries()] == ["hash a", "hash b"]


def test_rolling_back_keeps_later_versions_and_their_numbers(registry, small_calibration):
    with registry.writing():
        registry.commit(Entry("updated", "second", "b.zarr", "hash b"), small_calibration)
        assert registry.current == 2
        registry.roll_back(1)
    assert (registry.current, registry.versions) == (1, (1, 2))
    with registry.writing():
        with pytest.raises(InvalidInput, match="must be another than the one in use; received 1"):
            registry.roll_back(1)
        assert registry.current == 1
        assert registry.commit(Entry("updated", "third", "c.zarr", "hash c"), small_calibration).made == 3
    assert [entry.conclusion for entry in registry.entries()] == [
        "updated",
        "updated",
        "rolled_back",
        "updated",
    ]
    with (
        registry.writing(),
        pytest.raises(InvalidInput, match=r"must be one of the registry \(1, 2, 3\); received 9"),
    ):
        registry.roll_back(9)


def test_history_is_a_dataset_of_versions_and_parameters(registry, small_calibration):
    history = registry.history()
    own = small_calibration.summary()["parameters"]["coil1.radius_m"]
    radius = history.sel(version=1, parameter="coil1.radius_m")
    assert float(radius["median"]) == own["median"]
    assert [float(radius["lower90"]), float(radius["upper90"])] == own["ci90"]
    assert radius["unit"].item() == "m"
    assert not radius["is_derived"].item()


def test_a_second_job_is_refused_while_one_is_at_work(registry):
    with (
        registry.writing(),
        pytest.raises(InvalidInput, match="must be free; another recalibration"),
        Registry(registry.folder).writing(),
    ):
        pass
    with registry.writing():
        pass


DAMAGE = {
    "told is a word": ("told", "x\n", "registry must count who was told"),
    "told is negative": ("told", "-5\n", "registry must count who was told"),
    "told is empty": ("told", "", "registry must count who was told"),
    "summary is a list": ("versions/0001/summary.json", "[]", "must hold a JSON object; it holds \\[\\]"),
    "summary is null": ("versions/0001/summary.json", "null", "must hold a JSON object; it holds null"),
    "summary is deep": ("versions/0001/summary.json", "[" * 100_000, "must be JSON of at most 100 levels"),
    "provenance of a version without its line": (
        "versions/0001/provenance.json",
        "{}",
        "entry must have the keys that coilcal writes",
    ),
}


@pytest.mark.parametrize(("name", "text", "message"), DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_file_is_refused_in_a_sentence(registry, name, text, message):
    (registry.folder / name).write_text(text, encoding="utf-8")
    if "provenance" in name:
        (registry.folder / "log.jsonl").write_text("", encoding="utf-8")
    with pytest.raises(CorruptStore, match=message), registry.writing():  # noqa: PT012
        registry.tell(lambda _: None)
        registry.history()


LINES = ["first", "second", "third"]


def with_log(registry: Registry, change: Callable[[bytes], bytes]) -> bytes:
    """Three entries in the log, whose bytes were changed; what it holds then."""
    with registry.writing():
        for words in LINES[1:]:
            registry.commit(Entry("rejected", words, "b.zarr", f"hash {words}"))
    log = registry.folder / "log.jsonl"
    log.write_bytes(change(log.read_bytes()))
    return log.read_bytes()


def test_an_entry_whose_line_lacks_its_end_is_kept(registry):
    """A kill between the entry and its line feed, or an editor: the next entry would have been written behind it."""
    with_log(registry, lambda log: log.removesuffix(b"\n"))
    assert [entry.reason for entry in registry.entries()] == LINES
    with registry.writing():
        registry.commit(Entry("rejected", "fourth"))
    assert [entry.reason for entry in registry.entries()] == [*LINES, "fourth"]


@pytest.mark.parametrize("n_left", [1, 10, 60])
def test_a_torn_entry_is_cut_off(registry, n_left):
    with_log(registry, lambda log: log + log.splitlines()[2][:n_left])
    assert [entry.reason for entry in registry.entries()] == LINES
    with registry.writing():
        registry.commit(Entry("rejected", "fourth"))
    assert [entry.reason for entry in registry.entries()] == [*LINES, "fourth"]


@pytest.mark.parametrize(
    "change",
    [
        lambda log: log.replace(b"second", b"secund"),
        lambda log: log.replace(b"\n", b" ", 1),
        lambda log: log.replace(b"\n", b"\0"),
        lambda log: b"\0" * len(log),
        lambda log: log[20:],
        lambda log: log + b"garbage",
        lambda log: log.replace(b"\n", b" "),
        lambda log: log.replace(b"third", b"fourth").removesuffix(b"\n"),
        lambda log: b"\xff" + log,
    ],
)
def test_a_damaged_log_is_refused_and_left_as_it_is(registry, change):
    """It was cut off behind its last line end before anybody looked at it."""
    damaged = with_log(registry, change)
    with pytest.raises(CorruptStore) as caught, registry.writing():
        pass
    assert "\n" not in str(caught.value)
    assert (registry.folder / "log.jsonl").read_bytes() == damaged


def test_a_log_that_lost_what_was_told_is_refused(registry):
    with registry.writing():
        registry.commit(Entry("rejected", "bad", "b.zarr", "hash b"))
        registry.tell(lambda _: None)
    log = registry.folder / "log.jsonl"
    log.write_text(log.read_text().splitlines(keepends=True)[0])
    with pytest.raises(CorruptStore, match="must hold the 2 entries that were told"), registry.writing():
        pass


def test_a_log_of_version_0_2_is_read(registry):
    old = [Entry("rejected", words).line() + "\n" for words in LINES]
    (registry.folder / "log.jsonl").write_text("".join(old))
    with registry.writing():
        pass
    assert [entry.reason for entry in registry.entries()][:3] == LINES


@pytest.mark.parametrize("name", ["log.jsonl", "told", "versions/0001/summary.json"])
def test_a_pipe_in_the_registry_is_refused_at_once(registry, name):
    (registry.folder / name).unlink(missing_ok=True)
    os.mkfifo(registry.folder / name)
    with pytest.raises(CoilcalError, match="it is a named pipe"), registry.writing():
        registry.history()


def test_a_kill_at_any_step_leaves_the_last_version_and_the_next_job_goes_on(
    kept, tmp_path, small_calibration
):
    process = finished(PYTHON, "-W", "ignore", "-c", KILLS, kept, tmp_path / "work", timeout=120)
    assert process.returncode == 0, process.stderr
    seed = small_calibration.summary()["seed"]
    first, both = [[1], 1, ["hash a"]], [[1, 2], 2, ["hash a", "hash b"]]
    assert [json.loads(line) for line in process.stdout.splitlines()] == [
        ["before saving", 9, seed, *first],
        ["after saving", 9, seed, *both],
        ["in the log", 9, seed, *both],
        ["after the log", 9, seed, *both],
        ["after all", 9, seed, *both],
    ]

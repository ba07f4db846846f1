"""The checkpointed chain equals emcee's own, continues after any kill, and is never silently damaged."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import suppress
from pathlib import Path

import emcee
import numpy as np
import pytest
import xarray as xr
import zarr
from emcee.moves import DEMove, StretchMove

from estimator.errors import CorruptStore, InvalidInput
from estimator.store.emcee_backend import ZarrBackend
from tests.estimator.store.damaged import files, flipped, lost
from tests.estimator.store.interrupted import killed_at_each_operation

pytestmark = pytest.mark.whole

N_WALKERS, N_COORDINATES, CHECKPOINT_STEPS = 8, 2, 4
FINGERPRINT = "session A, rig A, seed 3"


def create(path: Path) -> ZarrBackend:
    return ZarrBackend.create(
        path,
        coordinate_names=["radius", "tilt"],
        n_walkers=N_WALKERS,
        checkpoint_steps=CHECKPOINT_STEPS,
        fingerprint=FINGERPRINT,
    )


def log_prob(x: np.ndarray) -> np.ndarray:
    return -0.5 * np.sum(x**2, axis=1)


def sample(backend: emcee.backends.Backend, n_steps: int) -> None:
    """Continue the chain of seed 3 by `n_steps`, or start it."""
    moves = [(DEMove(), 0.5), (StretchMove(), 0.5)]
    sampler = emcee.EnsembleSampler(
        N_WALKERS, N_COORDINATES, log_prob, backend=backend, vectorize=True, moves=moves
    )
    if backend.iteration:
        initial = backend.get_last_sample()
    else:
        random = np.random.RandomState(3)
        initial = emcee.State(random.normal(size=(N_WALKERS, N_COORDINATES)), random_state=random.get_state())
    for _ in sampler.sample(initial, iterations=n_steps):
        pass


def uninterrupted(n_steps: int) -> emcee.backends.Backend:
    """The same chain by emcee's own backend, without interruption."""
    backend = emcee.backends.Backend()
    sample(backend, n_steps)
    return backend


def assert_same(ours: emcee.backends.Backend, theirs: emcee.backends.Backend) -> None:
    """Bitwise equal in everything that a sampler or a reader can request."""
    assert ours.iteration == theirs.iteration
    assert ours.shape == theirs.shape
    for options in ({}, {"discard": 2, "thin": 2}, {"flat": True}):
        np.testing.assert_array_equal(ours.get_chain(**options), theirs.get_chain(**options))
        np.testing.assert_array_equal(ours.get_log_prob(**options), theirs.get_log_prob(**options))
    np.testing.assert_array_equal(ours.accepted, theirs.accepted)
    last = ours.get_last_sample()
    np.testing.assert_array_equal(last.coords, theirs.get_last_sample().coords)
    for our_part, their_part in zip(last.random_state, theirs.random_state, strict=True):
        np.testing.assert_array_equal(our_part, their_part)


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Two full chunks and a partial one."""
    path = tmp_path / "chain.zarr"
    backend = create(path)
    sample(backend, 2 * CHECKPOINT_STEPS + 1)
    backend.flush()
    return path


def test_continuing_after_any_number_of_steps_gives_the_uninterrupted_chain(tmp_path):
    expected = uninterrupted(11)
    for n_first in range(1, 11):
        path = tmp_path / f"{n_first}.zarr"
        backend = create(path)
        sample(backend, n_first)
        backend.flush()
        continued = ZarrBackend.open(path, fingerprint=FINGERPRINT)
        sample(continued, 11 - n_first)
        continued.flush()
        assert_same(ZarrBackend.open(path), expected)


def test_every_row_is_synced_to_the_disk_before_the_commit_that_counts_it(tmp_path, monkeypatch):
    """After a loss of power only what was synced is there; a commit may not come before its rows."""
    path = tmp_path / "chain.zarr"
    backend = create(path)
    sample(backend, CHECKPOINT_STEPS - 1)
    before = {file: file.read_bytes() for file in files(path)}
    synced: dict[Path, bytes] = {}
    committed_at_sync: list[bytes] = []  # what stood there whenever the names in the folder were synced
    fsync, replace = os.fsync, Path.replace

    def syncing(descriptor: int) -> None:
        file = Path(f"/proc/self/fd/{descriptor}").readlink()
        if file.is_file():
            synced[file] = file.read_bytes()
        elif file == path:
            committed_at_sync.append((path / "zarr.json").read_bytes())
        fsync(descriptor)

    def committing(self: Path, target: Path) -> Path:
        if target == path / "zarr.json":
            changed = {file for file in files(path) if file.read_bytes() != before.get(file)}
            assert {file.parts[len(path.parts)] for file in changed} >= {
                "chain",
                "log_prob",
                "checkpoint",
                "accepted",
            }
            assert {file: file.read_bytes() for file in changed} == {
                file: synced.get(file) for file in changed
            }
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", syncing)
    monkeypatch.setattr(Path, "replace", committing)
    sample(backend, 1)
    assert ZarrBackend.open(path).iteration == CHECKPOINT_STEPS
    assert committed_at_sync == [(path / "zarr.json").read_bytes()]


def test_plain_xarray_opens_the_store(store):
    expected = uninterrupted(9)
    with xr.open_zarr(store, consolidated=False) as dataset:
        assert dataset.chain.dims == ("step", "walker", "coordinate")
        assert dataset.log_prob.dims == ("step", "walker")
        np.testing.assert_array_equal(dataset.chain, expected.chain)
        np.testing.assert_array_equal(dataset.log_prob, expected.log_prob)
        np.testing.assert_array_equal(dataset.checkpoint, [4, 8, 9])
        np.testing.assert_array_equal(dataset.accepted.sel(checkpoint=4), uninterrupted(4).accepted)
        assert dataset.attrs["n_steps"] == 9
        assert dataset.attrs["coordinate_names"] == ["radius", "tilt"]


def test_chunks_are_one_checkpoint_long_compressed_and_checksummed(store):
    chain = zarr.open_array(store / "chain", mode="r")
    assert chain.chunks == (CHECKPOINT_STEPS, N_WALKERS, N_COORDINATES)
    assert [codec.to_dict()["name"] for codec in chain.compressors] == ["zstd", "crc32c"]


def test_opening_writes_nothing(store):
    before = [(file, file.stat().st_mtime_ns) for file in files(store)]
    ZarrBackend.open(store)
    assert [(file, file.stat().st_mtime_ns) for file in files(store)] == before


ENDLESS_RUN = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[2:]
import test_emcee_backend
backend = test_emcee_backend.ZarrBackend.open(Path(sys.argv[1]), fingerprint=test_emcee_backend.FINGERPRINT)
test_emcee_backend.sample(backend, test_emcee_backend.CHECKPOINT_STEPS)
print("committed", flush=True)
test_emcee_backend.sample(backend, 100_000)
"""


def test_kill_between_any_two_file_operations_keeps_the_last_commit(tmp_path, monkeypatch):
    path = tmp_path / "chain.zarr"
    create(path)
    n_committed = 0
    left_behind: list[tuple[Path, int]] = []
    real_replace = os.replace

    def replace_after_snapshot(source: Path, target: Path) -> None:
        # The files that a kill right now would leave: every file enters the store through os.replace.
        nonlocal n_committed
        snapshot = tmp_path / f"killed_{len(left_behind)}.zarr"
        shutil.copytree(path, snapshot)
        left_behind.append((snapshot, n_committed))
        real_replace(source, target)
        n_committed = json.loads((path / "zarr.json").read_bytes())["attributes"]["n_steps"]

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", replace_after_snapshot)
        backend = ZarrBackend.open(path)
        sample(backend, 6)
        backend.flush()  # a partial chunk, which the next commit writes again
        sample(backend, 4)
        backend.flush()

    assert sorted({n for _, n in left_behind}) == [0, 4, 6, 8]
    assert len(left_behind) == 4 * (2 * 4 + 1)  # per commit: chunk and zarr.json of 4 arrays, then the group
    expected = {n: uninterrupted(n) for n in (4, 6, 8, 13)}
    for snapshot, n_steps in left_behind:
        killed = ZarrBackend.open(snapshot)
        assert killed.iteration == n_steps
        if n_steps:
            assert_same(killed, expected[n_steps])
        sample(killed, 13 - n_steps)
        killed.flush()
        assert_same(ZarrBackend.open(snapshot), expected[13])


def test_torn_chunks_beyond_the_commit_are_overwritten(store):
    # A loss of power can leave torn files, whereas a kill leaves whole ones.
    (store / "chain" / "c" / "3" / "0").mkdir(parents=True)
    (store / "chain" / "c" / "3" / "0" / "0").write_text("torn")
    (store / "accepted" / "c" / "3").mkdir(parents=True)
    (store / "accepted" / "c" / "3" / "0").write_bytes(b"")
    backend = ZarrBackend.open(store)
    sample(backend, 5)
    backend.flush()
    assert_same(ZarrBackend.open(store), uninterrupted(14))


def test_half_used_pair_of_gaussian_draws_is_kept(tmp_path):
    # The generator draws two at a time and keeps the second as part of its state.
    path = tmp_path / "chain.zarr"
    backend = create(path)
    random = np.random.RandomState(5)
    coordinates = random.normal(size=(N_WALKERS, N_COORDINATES))
    random.normal()
    state = emcee.State(coordinates, log_prob=log_prob(coordinates), random_state=random.get_state())
    backend.grow(1, None)
    backend.save_step(state, np.ones(N_WALKERS, dtype=bool))
    backend.flush()
    restored = np.random.RandomState()
    restored.set_state(ZarrBackend.open(path).random_state)
    np.testing.assert_array_equal(restored.normal(size=3), random.normal(size=3))


def test_interrupted_call_followed_by_a_shorter_one_continues(tmp_path):
    backend = create(tmp_path / "chain.zarr")
    backend.grow(100, None)  # as a call for 100 steps does before its first step
    sample(backend, 3)
    assert_same(backend, uninterrupted(3))


def test_flipped_bit_never_changes_a_chain_silently(store):
    expected = uninterrupted(9)
    for file in flipped(store, 15):
        if file.name == "zarr.json" and file.parent != store:
            # Array metadata have harmless bits, such as the level of compression.
            with suppress(CorruptStore):
                assert_same(ZarrBackend.open(store), expected)
        else:
            with pytest.raises(CorruptStore, match=str(store)):
                ZarrBackend.open(store)
    assert_same(ZarrBackend.open(store), expected)


def test_missing_file_is_found(store):
    assert len(files(store)) == 1 + 4 + 4 * 3  # group, arrays, three chunks each
    for _ in lost(store):
        with pytest.raises(CorruptStore, match=f"{store} .*missing"):
            ZarrBackend.open(store)


def test_missing_chunk_is_found_when_nothing_was_ever_accepted(tmp_path):
    path = tmp_path / "chain.zarr"
    backend = create(path)
    backend.grow(CHECKPOINT_STEPS, None)
    zeros = np.zeros((N_WALKERS, N_COORDINATES))
    state = emcee.State(zeros, log_prob=zeros[:, 0], random_state=np.random.RandomState(0).get_state())
    for _ in range(CHECKPOINT_STEPS):
        backend.save_step(state, np.zeros(N_WALKERS, dtype=bool))
    assert ZarrBackend.open(path).iteration == CHECKPOINT_STEPS
    (path / "accepted" / "c" / "0" / "0").unlink()
    with pytest.raises(CorruptStore, match="'accepted'"):
        ZarrBackend.open(path)


def test_older_chunk_put_back_is_found(store):
    # Each chunk has a valid checksum; only the checksum of the whole array shows that this is the wrong chunk.
    shutil.copy(store / "chain" / "c" / "0" / "0" / "0", store / "chain" / "c" / "1" / "0" / "0")
    with pytest.raises(CorruptStore, match="'chain'"):
        ZarrBackend.open(store)


@pytest.mark.parametrize(
    ("old", "new"),
    [('"walker"', '"walkes"'), ('"float64"', '"int64"'), ("4,\n        8,\n", "4,\n        9,\n")],
)
def test_altered_array_layout_is_found(store, old, new):
    file = store / "chain" / "zarr.json"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(CorruptStore, match="'chain'"):
        ZarrBackend.open(store)


def test_other_schema_version_is_refused(store):
    file = store / "zarr.json"
    file.write_text(file.read_text().replace('"schema_version": 1', '"schema_version": 2'))
    with pytest.raises(CorruptStore, match=r"schema version 1; received 2 .*chain\.zarr"):
        ZarrBackend.open(store)


def test_other_fingerprint_is_refused(store):
    with pytest.raises(InvalidInput, match=f"'seed 4'; received '{FINGERPRINT}' .*{store}"):
        ZarrBackend.open(store, fingerprint="seed 4")


def refuse(*_: object) -> None:
    raise OSError(28, "No space left on device")


def test_full_disk_is_explained_and_loses_nothing(store, monkeypatch):
    backend = ZarrBackend.open(store)
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", refuse)
        with pytest.raises(InvalidInput, match=f"writable; {store} is not: No space left on device"):
            sample(backend, CHECKPOINT_STEPS)
    assert_same(ZarrBackend.open(store), uninterrupted(9))
    backend.flush()  # with room again, nothing is lost
    assert_same(ZarrBackend.open(store), uninterrupted(12))


def test_unwritable_path_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match=r"writable; .*file/chain\.zarr"):
        create(tmp_path / "file" / "chain.zarr")


def test_existing_store_is_not_overwritten(store):
    with pytest.raises(InvalidInput, match="must not exist yet"):
        create(store)
    assert_same(ZarrBackend.open(store), uninterrupted(9))


def test_killed_at_any_file_operation_a_new_store_is_absent_or_whole(tmp_path):
    path = tmp_path / "chain.zarr"
    for _ in killed_at_each_operation(lambda: create(path), one_in=20):
        if path.exists():
            assert ZarrBackend.open(path).iteration == 0
            shutil.rmtree(path)
    create(path)
    assert [path.name for path in tmp_path.iterdir()] == ["chain.zarr"]


@pytest.mark.parametrize("changed", [{"n_walkers": 0}, {"checkpoint_steps": 0}, {"coordinate_names": []}])
def test_empty_ensemble_or_checkpoint_is_refused(tmp_path, changed):
    settings = {"coordinate_names": ["x"], "n_walkers": 4, "checkpoint_steps": 5, "fingerprint": ""}
    with pytest.raises(InvalidInput, match="must be >= 1"):
        ZarrBackend.create(tmp_path / "chain.zarr", **(settings | changed))


@pytest.mark.parametrize(
    ("act", "rule"),
    [
        (lambda backend: backend.reset(N_WALKERS, N_COORDINATES), "must not be reset"),
        (lambda backend: backend.grow(1, np.zeros(N_WALKERS)), "no blobs"),
    ],
)
def test_what_the_store_cannot_hold_is_refused(tmp_path, act, rule):
    with pytest.raises(InvalidInput, match=rule):
        act(create(tmp_path / "chain.zarr"))

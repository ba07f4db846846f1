"""Stores that tests alter and seal anew, and what a refusal looks like."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zarr

from estimator.errors import CoilcalError, CorruptStore
from estimator.store.arrays import digest
from estimator.store.session import Session

N = 36  # readings of the small session


def refusal(load: Callable[[Path], object], path: Path, kind: type[CoilcalError] = CorruptStore) -> str:
    with pytest.raises(kind) as caught:
        load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 600
    return message


@pytest.fixture(scope="module")
def session_store(small_session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stores") / "session.zarr"
    small_session.save(path)
    return path


@pytest.fixture
def session(session_store: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(session_store, tmp_path / "session.zarr"))


def replace_array(session: Path, name: str, data: np.ndarray) -> None:
    """Another array in place of one, with attributes that were sealed anew."""
    group = zarr.open_group(session, mode="r+")
    del group[name]
    names = [f"axis{i}" for i in range(data.ndim)]
    array = group.create_array(
        name, shape=data.shape, dtype=data.dtype, dimension_names=names, compressors=None
    )
    array[...] = data
    seal(session)


def seal(session: Path) -> None:
    node = json.loads((session / "zarr.json").read_text(encoding="utf-8"))
    group = zarr.open_group(session, mode="r")
    arrays = {n: (tuple(a.metadata.dimension_names), np.asarray(a[...])) for n, a in group.arrays()}
    node["attributes"].pop("sha256")
    node["attributes"]["sha256"] = digest(arrays, node["attributes"])
    (session / "zarr.json").write_text(json.dumps(node), encoding="utf-8")

"""Calibrations that were altered, with and without the seal of their summary: refused, with nothing unpickled."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

from estimator.calibration.files import SUMMARY_SEAL
from estimator.calibration.result import Calibration
from estimator.store.tree import read_tree, tree_hash
from tests.estimator.attack.conftest import refusal

pytestmark = pytest.mark.whole


@pytest.fixture
def calibration(small_calibration: Calibration, tmp_path: Path) -> Path:
    small_calibration.save(tmp_path / "calibration")
    return tmp_path / "calibration"


def without_seal(calibration: Path, change: Callable[[xr.DataTree], object] = lambda _: None) -> None:
    """A posterior that was altered and hashed anew, without the seal of its summary, as versions before wrote it."""
    store = calibration / "posterior.zarr"
    with xr.open_datatree(store, engine="zarr", consolidated=False) as tree:
        tree.load()
    for key in ("sha256", SUMMARY_SEAL):
        tree.attrs.pop(key)
    change(tree)
    shutil.rmtree(store)
    tree.to_zarr(store, mode="w", zarr_format=3, consolidated=False)
    zarr.open_group(store, mode="a").attrs["sha256"] = tree_hash(read_tree(store))


def test_any_changed_byte_of_a_summary_is_found(calibration):
    file = calibration / "summary.json"
    content = file.read_bytes()
    random = np.random.default_rng(1)
    for bit in random.choice(8 * len(content), 20, replace=False):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << (bit % 8)
        file.write_bytes(damaged)
        assert str(calibration) in refusal(Calibration.load, calibration)
    file.write_bytes(content)
    Calibration.load(calibration)


def test_a_summary_of_another_calibration_is_found(calibration, small_calibration):
    other = json.loads(json.dumps(small_calibration.summary())) | {"seed": 12}
    (calibration / "summary.json").write_text(json.dumps(other, indent=2) + "\n", encoding="utf-8")
    assert "was altered, or belongs to another posterior" in refusal(Calibration.load, calibration)


def test_a_calibration_from_before_the_seal_opens(calibration, small_calibration):
    without_seal(calibration)
    assert Calibration.load(calibration).best == small_calibration.best


SUMMARIES = {
    "list": "[1, 2]",
    "null": "null",
    "nothing": "",
    "a number": "5",
    "text": '"x"',
    "{}": "{}",
    "depth": "[" * 100_000,
}


@pytest.mark.parametrize("text", SUMMARIES.values(), ids=SUMMARIES)
@pytest.mark.parametrize("is_sealed", [True, False])
def test_a_summary_that_is_none_is_refused(calibration, text, is_sealed):
    if not is_sealed:
        without_seal(calibration)
    (calibration / "summary.json").write_text(text, encoding="utf-8")
    refusal(Calibration.load, calibration)


@pytest.mark.parametrize(
    "key", ["parameters", "rmse", "coverage90", "sampling", "loop_counts", "undetermined", "truth"]
)
def test_a_summary_from_before_the_seal_has_what_pages_read(calibration, key):
    without_seal(calibration)
    summary = json.loads((calibration / "summary.json").read_text(encoding="utf-8"))
    for changed in ({**summary, key: None}, {k: v for k, v in summary.items() if k != key}):
        (calibration / "summary.json").write_text(json.dumps(changed), encoding="utf-8")
        refusal(Calibration.load, calibration)


def with_best(value: object) -> Callable[[xr.DataTree], None]:
    def change(tree: xr.DataTree) -> None:
        tree.attrs["best"] = json.dumps({**json.loads(tree.attrs["best"]), "coil1.radius_m": value})

    return change


def with_draws(value: float) -> Callable[[xr.DataTree], None]:
    def change(tree: xr.DataTree) -> None:
        tree["posterior"]["coil1.radius_m"].to_numpy()[3] = value

    return change


def few_draws(tree: xr.DataTree) -> None:
    dataset = tree["posterior"].to_dataset().drop_vars("coil1.radius_m")
    tree["posterior"] = xr.DataTree(dataset.assign({"coil1.radius_m": (("a", "b"), np.zeros((2, 2)))}))


POSTERIORS = {
    "a best value that is no number": (with_best(float("nan")), "calibration must be JSON; NaN is no finite number"),
    "a best value in words": (with_best("x"), "calibration must be readable"),
    "a list of best values": (lambda t: t.attrs.update(best="[1]"), "calibration must be readable"),
    "no best values": (lambda t: t.attrs.update(best="{}"), "calibration must be readable"),
    "draws that are no numbers": (with_draws(np.nan), "draws of coil1.radius_m must be finite and of shape"),
    "few draws": (few_draws, "draws of coil1.radius_m must be finite and of shape"),
    "a parameter without draws": (lambda t: t["posterior"].__delitem__("coil1.radius_m"), "must be readable"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), POSTERIORS.values(), ids=POSTERIORS)
def test_a_posterior_that_predicts_nothing_is_refused(calibration, change, message):
    without_seal(calibration, change)
    assert message in refusal(Calibration.load, calibration)


class Touch:
    """Runs a command of the shell where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (f"touch {self.path}",)


def test_format_2_with_pickled_objects_is_not_unpickled(calibration, tmp_path):
    store = calibration / "posterior.zarr"
    shutil.rmtree(store)
    (store / "posterior" / "x").mkdir(parents=True)
    for folder in (store, store / "posterior"):
        (folder / ".zgroup").write_text('{"zarr_format": 2}', encoding="utf-8")
    node = {"zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "order": "C", "fill_value": None}
    node |= {"compressor": None, "filters": [{"id": "pickle", "protocol": 4}]}
    (store / "posterior" / "x" / ".zarray").write_text(json.dumps(node), encoding="utf-8")
    (store / "posterior" / "x" / "0").write_bytes(pickle.dumps(Touch(tmp_path / "run")))
    assert "calibration must be of zarr format 3" in refusal(Calibration.load, calibration)
    assert not (tmp_path / "run").exists()

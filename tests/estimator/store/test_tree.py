"""`read_tree` finds what xarray finds in a tree of datasets, without it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from estimator.store.tree import read_tree, tree_hash


@pytest.fixture
def path(tmp_path: Path) -> Path:
    draws = (("chain", "draw"), np.array([[0.5, np.nan, 1.0], [2.0, -0.0, np.inf]]))
    coords = {"chain": np.arange(2), "draw": np.arange(3)}
    flags = {
        "is_validation": ("reading", np.array([True, False])),
        "sensor_index": ("reading", np.array([0, -1])),
    }
    tree = xr.DataTree.from_dict(
        {
            "/": xr.Dataset(attrs={"schema_version": 1, "best": '{"a": 1.5}'}),
            "/posterior": xr.Dataset({"coil1.radius_m": draws}, coords, {"inference_library": "emcee"}),
            "/constant_data": xr.Dataset(flags),
        }
    )
    tree.to_zarr(tmp_path / "tree.zarr", mode="w", zarr_format=3, consolidated=False)
    return tmp_path / "tree.zarr"


def test_groups_attributes_axes_and_numbers_are_those_of_xarray(path):
    found = read_tree(path)
    with xr.open_datatree(path, engine="zarr", consolidated=False, zarr_format=3) as tree:
        assert {node.path for node in tree.subtree} == set(found)
        for node in tree.subtree:
            own = found[node.path]
            assert own.attributes == node.attrs
            assert set(own.variables) == set(node.dataset.variables)
            assert set(own.arrays) == set(node.data_vars)
            for name, variable in node.dataset.variables.items():
                axes, array = own.variables[str(name)]
                assert axes == variable.dims
                assert array.dtype == variable.dtype
                assert np.array_equal(array, variable.to_numpy(), equal_nan=array.dtype.kind == "f")


def test_the_hash_covers_numbers_and_attributes(path):
    before = tree_hash(read_tree(path))
    assert tree_hash(read_tree(path)) == before
    other = read_tree(path)
    other["/constant_data"].variables["sensor_index"][1][0] = 1
    assert tree_hash(other) != before
    other = read_tree(path)
    other["/"].attributes["best"] = "{}"
    assert tree_hash(other) != before

"""Reads groups of named arrays as xarray writes a tree of datasets in zarr v3, without xarray, which takes almost a second to load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimator.store.arrays import digest, quiet_zarr


@dataclass(frozen=True)
class Node:
    """One group: its attributes, and each array with the names of its axes."""

    attributes: dict[str, Any]
    variables: Mapping[str, tuple[tuple[str, ...], np.ndarray]]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays that are no coordinates: those along one axis of their own name."""
        return {name: array for name, (axes, array) in self.variables.items() if axes != (name,)}


def read_tree(path: Path) -> dict[str, Node]:
    """The group at a path and those in it, by their paths in it: `/`, `/posterior`."""
    import zarr

    with quiet_zarr():
        root = zarr.open_group(path, mode="r", zarr_format=3, use_consolidated=False)
        groups = {"/": root, **{f"/{name}": group for name, group in root.groups()}}
        return {name: _node(group) for name, group in groups.items()}


def _node(group: Any) -> Node:
    variables = {
        name: (tuple(array.metadata.dimension_names or ()), np.asarray(array[...]))
        for name, array in group.arrays()
    }
    return Node(dict(group.attrs.asdict()), variables)


def tree_hash(tree: Mapping[str, Node]) -> str:
    """SHA-256 over every array and attribute of a tree."""
    arrays = {
        f"{path} {name}": variable for path, node in tree.items() for name, variable in node.variables.items()
    }
    return digest(arrays, {path: node.attributes for path, node in tree.items()})

"""Groups of named arrays in zarr v3, laid out as xarray has a tree of datasets, without xarray, which takes almost a second to load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimator.store.arrays import digest, quiet_zarr

LONGEST_CHUNK = 65_536  # numbers along an axis


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


def write_tree(path: Path, tree: Mapping[str, Node]) -> None:
    """Write what `read_tree` reads."""
    import zarr

    with quiet_zarr():
        root = zarr.open_group(path, mode="w", zarr_format=3)
        for name, node in tree.items():
            group = root if name == "/" else root.create_group(name.removeprefix("/"))
            write_arrays(group, node.variables)
            group.attrs.update(node.attributes)


def write_arrays(group: Any, variables: Mapping[str, tuple[tuple[str, ...], np.ndarray]]) -> None:
    """Write arrays with the names of their axes into a group of zarr; every chunk has a checksum."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    for name, (axes, data) in variables.items():
        array = group.create_array(
            name,
            shape=data.shape,
            chunks=tuple(max(1, min(n, LONGEST_CHUNK)) for n in data.shape),
            dtype=data.dtype,
            fill_value=np.nan if data.dtype.kind == "f" else 0,  # where a chunk is lost
            compressors=[ZstdCodec(level=3), Crc32cCodec()],
            dimension_names=list(axes),
        )
        array[...] = data


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

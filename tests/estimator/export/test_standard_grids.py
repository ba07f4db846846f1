"""Grids of VTK and openPMD, read back by code of its own after their specifications."""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ET
from pathlib import Path

import h5py
import numpy as np
import pytest
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.export.request import Grid

UNEVEN = Grid(np.array([-0.02, 0.01, 0.03, 0.094]), np.array([0.0, 0.01, 0.02]), np.array([0.0, 0.038]))
EVEN = Grid(np.linspace(-0.02, 0.094, 4), np.linspace(0.0, 0.02, 3), np.linspace(0.0, 0.038, 2))
TYPES = {"Float64": "<f8", "UInt8": "<u1"}


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays by name, from inline base64 after a number of bytes of 64 bits."""
    root = ET.parse(path).getroot()
    assert (root.get("type"), root.get("header_type")) == ("RectilinearGrid", "UInt64")
    arrays = {}
    for element in root.iter("DataArray"):
        data = base64.b64decode(element.text or "")
        assert int.from_bytes(data[:8], "little") == len(data) - 8
        arrays[element.attrib["Name"]] = np.frombuffer(data[8:], TYPES[element.attrib["type"]])
    return arrays


def expected(
    magnet: Calibration, currents_A: dict[str, float], motion: dict[str, Tensor], grid: Grid
) -> tuple[np.ndarray, np.ndarray]:
    field_T, gradient = (
        of(grid.points_m, currents_A, motion).numpy() for of in (magnet.field, magnet.gradient)
    )
    return field_T.reshape(*grid.shape, 3), gradient.reshape(*grid.shape, 3, 3)


def test_vtk_grid_holds_field_and_gradient_with_x_fastest(magnet, currents_A, motion, tmp_path):
    path = magnet.export("vtk", tmp_path / "f.vtr", grid=UNEVEN, currents_A=currents_A, motion=motion)
    arrays = read_arrays(path)
    extents = [element.get("Extent") for element in ET.parse(path).getroot().iter("Piece")]
    assert extents == ["0 3 0 2 0 1"]
    for axis in "xyz":
        np.testing.assert_array_equal(arrays[f"{axis}_m"], getattr(UNEVEN, f"{axis}_m"))
    field_T, gradient = expected(magnet, currents_A, motion, UNEVEN)
    read_T = arrays["B_T"].reshape(2, 3, 4, 3)
    read_gradient = arrays["dB_dx_T_per_m"].reshape(2, 3, 4, 3, 3)
    for i in range(4):
        for j in range(3):
            for k in range(2):
                np.testing.assert_allclose(read_T[k, j, i], field_T[i, j, k], rtol=1e-12)
                np.testing.assert_allclose(read_gradient[k, j, i], gradient[i, j, k], rtol=1e-9, atol=1e-15)
    assert arrays["inside_winding"].reshape(2, 3, 4)[1, 0, 3] == 1
    assert arrays["inside_winding"].sum() == np.isnan(field_T).any(-1).sum() >= 1


def test_openpmd_has_what_the_standard_asks_for(magnet, currents_A, motion, tmp_path):
    path = magnet.export("openpmd", tmp_path / "f.h5", grid=EVEN, currents_A=currents_A, motion=motion)
    field_T, gradient = expected(magnet, currents_A, motion, EVEN)
    with h5py.File(path) as file:
        texts = {key: value.decode() for key, value in file.attrs.items() if isinstance(value, bytes)}
        assert texts["openPMD"] == "1.1.0"
        assert file.attrs["openPMDextension"].dtype == np.uint32
        assert texts["iterationEncoding"] == "groupBased"
        iteration = file[texts["basePath"].replace("%T", "0")]
        assert {key: iteration.attrs[key] for key in ("time", "dt", "timeUnitSI")} == {
            "time": 0.0,
            "dt": 1.0,
            "timeUnitSI": 1.0,
        }
        meshes = iteration[texts["meshesPath"]]
        assert list(meshes["B"].attrs["unitDimension"]) == [0, 1, -2, -1, 0, 0, 0]
        assert list(meshes["gradB"].attrs["unitDimension"]) == [-1, 1, -2, -1, 0, 0, 0]
        for record in meshes.values():
            attributes = record.attrs
            assert (attributes["geometry"], attributes["dataOrder"]) == (b"cartesian", b"C")
            assert list(attributes["axisLabels"]) == [b"x", b"y", b"z"]
            ends_m = attributes["gridGlobalOffset"] + attributes["gridSpacing"] * (np.array(EVEN.shape) - 1)
            np.testing.assert_allclose(ends_m * attributes["gridUnitSI"], [0.094, 0.02, 0.038], rtol=1e-12)
            for component in record.values():
                assert component.attrs["unitSI"] == 1.0
                assert list(component.attrs["position"]) == [0.0, 0.0, 0.0]
        for number, axis in enumerate("xyz"):
            np.testing.assert_allclose(meshes["B"][axis], field_T[..., number], rtol=1e-12)
            np.testing.assert_allclose(
                meshes["gradB"][f"x{axis}"], gradient[..., 0, number], rtol=1e-9, atol=1e-15
            )


def test_openpmd_needs_even_spacing(magnet, currents_A, motion, tmp_path):
    with pytest.raises(InvalidInput, match="grid of openpmd must have evenly spaced points along x"):
        magnet.export("openpmd", tmp_path / "f.h5", grid=UNEVEN, currents_A=currents_A, motion=motion)
    assert not (tmp_path / "f.h5").exists()

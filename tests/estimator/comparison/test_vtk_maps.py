"""Grids of VTK: files in each way of packing, written after the specification; reading what VTK 9.7.2 wrote in 48 ways was tried by hand."""

from __future__ import annotations

import base64
import itertools
import zlib
from pathlib import Path

import numpy as np
import pytest

from estimator.comparison.map_files import read_map
from estimator.errors import InvalidInput

SHAPE = (9, 8, 7)
AXES_M = tuple(
    np.linspace(low, high, n)
    for (low, high), n in zip(((-0.02, 0.02), (0, 0.01), (1, 2)), SHAPE, strict=True)
)
FIELD_T = np.random.default_rng(4).normal(size=(*SHAPE, 3))


def packed(data: bytes, is_compressed: bool, is_raw: bool) -> bytes:
    """A header of 32 bits and the data; compressed in blocks of 100 bytes, where the header is encoded by itself."""

    def text(part: bytes) -> bytes:
        return part if is_raw else base64.b64encode(part)

    if not is_compressed:
        return text(np.uint32(len(data)).tobytes() + data)
    blocks = [zlib.compress(data[i : i + 100]) for i in range(0, len(data), 100)]
    head = np.array([len(blocks), 100, len(data) % 100, *map(len, blocks)], dtype="<u4")
    return text(head.tobytes()) + text(b"".join(blocks))


def write(path: Path, mode: str, is_compressed: bool = False, name: str = "B", attributes: str = "") -> Path:
    in_order = np.ascontiguousarray(FIELD_T.transpose(2, 1, 0, 3))
    extent = " ".join(f"0 {n - 1}" for n in SHAPE)
    compressor = ' compressor="vtkZLibDataCompressor"' if is_compressed else ""
    appended = b""

    def array(label: str, values: np.ndarray, components: int) -> bytes:
        nonlocal appended
        begin = f'<DataArray type="Float64" Name="{label}" NumberOfComponents="{components}" '.encode()
        if mode == "ascii":
            return (
                begin
                + b'format="ascii">'
                + " ".join(map(repr, values.ravel().tolist())).encode()
                + b"</DataArray>"
            )
        data = packed(values.tobytes(), is_compressed, mode == "raw")
        if mode == "inline":
            return begin + b'format="binary">' + data + b"</DataArray>"
        begin += f'format="appended" offset="{len(appended)}"/>'.encode()
        appended += data
        return begin

    body = b"<PointData>" + array(name, in_order, 3) + b"</PointData>"
    if path.suffix == ".vtr":
        kind, where = "RectilinearGrid", ""
        coordinates = b"".join(array(axis, values, 1) for axis, values in zip("xyz", AXES_M, strict=True))
        body += b"<Coordinates>" + coordinates + b"</Coordinates>"
    else:
        kind = "ImageData"
        origin = " ".join(repr(float(axis[0])) for axis in AXES_M)
        spacing = " ".join(repr(float(axis[1] - axis[0])) for axis in AXES_M)
        where = f' Origin="{origin}" Spacing="{spacing}"{attributes}'
    top = (
        f'<VTKFile type="{kind}" byte_order="LittleEndian"{compressor}><{kind} WholeExtent="{extent}"{where}>'
    )
    text = top.encode() + f'<Piece Extent="{extent}">'.encode() + body + f"</Piece></{kind}>".encode()
    if mode in ("raw", "base64"):
        text += f'<AppendedData encoding="{mode}">_'.encode() + appended + b"</AppendedData>"
    path.write_bytes(text + b"</VTKFile>")
    return path


@pytest.mark.parametrize(
    ("mode", "is_compressed", "suffix"),
    [
        ("ascii", False, ".vti"),
        *itertools.product(("inline", "raw", "base64"), (False, True), (".vti", ".vtr")),
    ],
)
def test_however_it_is_packed_the_map_is_the_same(mode, is_compressed, suffix, tmp_path):
    read = read_map(write(tmp_path / f"map{suffix}", mode, is_compressed), current_A=2.0)
    np.testing.assert_array_equal(read.values, FIELD_T / 2.0)
    for found, given in zip(read.axes_m, AXES_M, strict=True):
        np.testing.assert_allclose(found, given, rtol=1e-12, atol=1e-15)


def test_what_it_cannot_be_is_said(tmp_path):
    path = write(tmp_path / "map.vti", "inline", name="H")
    with pytest.raises(InvalidInput, match="must have point data B_T or B; received H"):
        read_map(path, 1.0)
    turned = write(tmp_path / "turned.vti", "inline", attributes=' Direction="0 1 0 1 0 0 0 0 1"')
    with pytest.raises(InvalidInput, match="must lie along the axes of the coil"):
        read_map(turned, 1.0)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InvalidInput, match="must be a grid of VTK in one piece"):
        read_map(path, 1.0)
    path.write_bytes(content.replace(b"ImageData", b"UnstructuredGrid"))
    with pytest.raises(InvalidInput, match="must be ImageData or a RectilinearGrid"):
        read_map(path, 1.0)

"""Grids of VTK's XML format (`.vti`, `.vtr`), as ParaView, FEM programs and `coilcal export --to vtk` write them, without the VTK library.

One piece, uncompressed or by zlib, inline or appended, as text, base64 or raw.
"""

from __future__ import annotations

import base64
import binascii
import re
import xml.etree.ElementTree as ET
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimator.errors import InvalidInput

SUFFIXES = (".vti", ".vtr")
FIELDS = ("B_T", "B")
TYPES = {"Float32": "f4", "Float64": "f8"}
HEADERS = {"UInt32": "u4", "UInt64": "u8"}
APPENDED = re.compile(rb"<AppendedData\b[^>]*>\s*_")
CLOSED = re.compile(rb"\s*</AppendedData>")


@dataclass(frozen=True)
class _Source:
    """File from which arrays are read, and how they are packed in it."""

    path: Path
    header: np.dtype[np.unsignedinteger]
    order: str
    is_compressed: bool
    is_raw: bool
    appended: bytes


def read_vtk(path: Path, content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Points in metres and field in tesla, both (point, 3); VTK has no units, so both are taken to be SI.

    Args:
        path: The file, for messages.
        content: Its bytes.
    Raises:
        InvalidInput: The file is not such a grid, is turned, or has no field named B or B_T.
    """
    try:
        root, source = _opened(path, content)
        grid = root[0]
        extent = [int(number) for number in grid.attrib["WholeExtent"].split()]
        axes_m = _axes_m(root, grid, extent, source)
        arrays = {array.get("Name"): array for array in grid.findall("Piece/PointData/DataArray")}
        name = next((name for name in FIELDS if name in arrays), None)
        if name is None:
            raise InvalidInput(
                f"field map must have point data {' or '.join(FIELDS)}; received {', '.join(map(str, arrays)) or 'none'} ({path})"
            )
        shape = tuple(map(len, axes_m))
        field = _values(arrays[name], source).reshape(*shape[::-1], 3).transpose(2, 1, 0, 3)
    except (ET.ParseError, KeyError, IndexError, ValueError, zlib.error, binascii.Error) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"field map must be a grid of VTK in one piece; {path} is not: {error}") from error
    points_m = np.stack(np.meshgrid(*axes_m, indexing="ij"), axis=-1).reshape(-1, 3)
    return points_m, field.reshape(-1, 3)


def _opened(path: Path, content: bytes) -> tuple[ET.Element, _Source]:
    """The XML without its appended data, which may be no text, and how to read arrays."""
    appended = b""
    begin = APPENDED.search(content)
    if begin is not None:
        end = list(CLOSED.finditer(content, begin.end()))[-1]
        appended = content[begin.end() : end.start()]
        content = content[: begin.end()] + content[end.start() :]
    root = ET.fromstring(content)
    kind = root.attrib["type"]
    if kind not in ("ImageData", "RectilinearGrid") or len(root[0].findall("Piece")) != 1:
        raise InvalidInput(
            f"field map must be ImageData or a RectilinearGrid in one piece; received {kind} ({path})"
        )
    compressor = root.get("compressor")
    if compressor not in (None, "vtkZLibDataCompressor"):
        raise InvalidInput(f"field map must be compressed by zlib, if at all; received {compressor} ({path})")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    header = np.dtype(order + HEADERS[root.get("header_type", "UInt32")])
    is_raw = b'encoding="raw"' in (begin.group() if begin else b"")
    return root, _Source(path, header, order, compressor is not None, is_raw, appended)


def _axes_m(root: ET.Element, grid: ET.Element, extent: list[int], source: _Source) -> list[np.ndarray]:
    if root.attrib["type"] == "RectilinearGrid":
        return [_values(array, source) for array in grid.findall("Piece/Coordinates/DataArray")]
    direction = [float(number) for number in grid.get("Direction", "1 0 0 0 1 0 0 0 1").split()]
    if direction != [1, 0, 0, 0, 1, 0, 0, 0, 1]:
        raise InvalidInput(
            f"field map must lie along the axes of the coil; its Direction turns it ({source.path})"
        )
    origin, spacing = (
        [float(number) for number in grid.attrib[key].split()] for key in ("Origin", "Spacing")
    )
    ends = zip(extent[::2], extent[1::2], strict=True)
    return [
        o + s * np.arange(first, last + 1) for o, s, (first, last) in zip(origin, spacing, ends, strict=True)
    ]


def _values(array: ET.Element, source: _Source) -> np.ndarray:
    """Numbers of an array, in double precision."""
    kind, text = array.get("format", "ascii"), (array.text or "").strip()
    if kind == "ascii":
        return np.array(text.split(), dtype=float)
    number_type = np.dtype(source.order + TYPES[array.attrib["type"]])
    if kind == "appended":
        packed, is_raw = source.appended[int(array.attrib["offset"]) :], source.is_raw
    else:
        packed, is_raw = text.encode("ascii"), False
    return np.frombuffer(_unpacked(packed, is_raw, source), number_type).astype(float)


def _unpacked(packed: bytes, is_raw: bool, source: _Source) -> bytes:
    """Bytes of an array that begin with a header: their number, or numbers and sizes of compressed blocks."""
    size = source.header.itemsize
    if not source.is_compressed:
        head = _take(packed, size, is_raw)
        n_bytes = int(np.frombuffer(head, source.header)[0])
        return _take(packed, size + n_bytes, is_raw)[size:]
    n_blocks = int(np.frombuffer(_take(packed, size, is_raw), source.header)[0])
    head_size = size * (3 + n_blocks)
    sizes = np.frombuffer(_take(packed, head_size, is_raw), source.header)[3:].astype(int)
    # In base64 the header is padded by itself.
    rest = packed[head_size if is_raw else 4 * -(-head_size // 3) :]
    blocks = _take(rest, int(sizes.sum()), is_raw)
    ends = np.cumsum(sizes)
    return b"".join(
        zlib.decompress(blocks[end - length : end]) for end, length in zip(ends, sizes, strict=True)
    )


def _take(packed: bytes, count: int, is_raw: bool) -> bytes:
    """The first bytes."""
    if is_raw:
        return packed[:count]
    return base64.b64decode(packed[: 4 * -(-count // 3)])[:count]

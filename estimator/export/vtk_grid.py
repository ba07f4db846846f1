"""Field and gradient on a rectilinear grid in VTK's XML format, for ParaView and VisIt: any model, iron and corrections included."""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from estimator.export.request import Request

TYPES = {"f8": "Float64", "u1": "UInt8"}
FIELD, GRADIENT, INSIDE = "B_T", "dB_dx_T_per_m", "inside_winding"


def vtk_grid(request: Request) -> str:
    """The text of the file: at every point the field, nine entries dB_i/dx_j row by row, and whether it lies inside a winding (NaN there).

    Raises:
        InvalidInput: No grid, no currents, or a name that is not there.
    """
    grid, field_T, gradient = request.on_grid()
    extent = " ".join(f"0 {n - 1}" for n in grid.shape)
    root = ET.Element(
        "VTKFile",
        {
            "type": "RectilinearGrid",
            "version": "1.0",
            "byte_order": "LittleEndian",
            "header_type": "UInt64",
        },
    )
    piece = ET.SubElement(
        ET.SubElement(root, "RectilinearGrid", {"WholeExtent": extent}), "Piece", {"Extent": extent}
    )
    point_data = ET.SubElement(piece, "PointData", {"Vectors": FIELD, "Tensors": GRADIENT})
    arrays = {FIELD: field_T, GRADIENT: gradient, INSIDE: np.isnan(field_T).any(-1)[..., None].astype("u1")}
    for name, values in arrays.items():
        in_order = values.reshape(*grid.shape, -1).transpose(2, 1, 0, 3)  # x runs fastest
        _array(point_data, name, in_order, {"NumberOfComponents": str(in_order.shape[-1])})
    coordinates = ET.SubElement(piece, "Coordinates")
    for axis in "xyz":
        _array(coordinates, f"{axis}_m", getattr(grid, f"{axis}_m"), {})
    ET.indent(root)
    comment = f"{request.words}; SI units, world frame; {request.magnet.origin}".replace("--", "-")
    return f'<?xml version="1.0"?>\n<!-- {comment} -->\n{ET.tostring(root, encoding="unicode")}\n'


def _array(parent: ET.Element, name: str, values: np.ndarray, attributes: Mapping[str, str]) -> None:
    """An array in base64, after its number of bytes."""
    kind = values.dtype.str[1:]
    data = np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    described = {"type": TYPES[kind], "Name": name, **attributes, "format": "binary"}
    text = base64.b64encode(np.uint64(len(data)).astype("<u8").tobytes() + data).decode("ascii")
    ET.SubElement(parent, "DataArray", described).text = text

"""Field and gradient on a grid after the openPMD standard 1.1.0, in HDF5: any model, iron and corrections included.

Text attributes have a fixed length, as the standard's HDF5 page asks.
"""

from __future__ import annotations

import io
from itertools import product

import h5py
import numpy as np

from estimator.code_version import code_version
from estimator.errors import InvalidInput
from estimator.export.request import Request

VERSION = "1.1.0"
BASE, MESHES = "/data/%T/", "meshes/"
# Powers of metre, kilogram, second, ampere, kelvin, mole, candela.
TESLA = (0.0, 1.0, -2.0, -1.0, 0.0, 0.0, 0.0)
TESLA_PER_METRE = (-1.0, *TESLA[1:])


def openpmd(request: Request) -> bytes:
    """A file with meshes `B` (components x, y, z) and `gradB` (`xy` is dB_x / dy) of one iteration; NaN inside a winding.

    Raises:
        InvalidInput: No evenly spaced grid, no currents, or a name that is not there.
    """
    grid, field_T, gradient = request.on_grid()
    spacings_m, offsets_m = [], []
    for axis in "xyz":
        coordinates_m = getattr(grid, f"{axis}_m")
        steps_m = np.diff(coordinates_m)
        if len(steps_m) and abs(steps_m - steps_m[0]).max() > 1e-9 * abs(steps_m[0]):
            raise InvalidInput(
                f"grid of openpmd must have evenly spaced points along {axis}; received others"
            )
        spacings_m.append(float(steps_m[0]) if len(steps_m) else 1.0)
        offsets_m.append(float(coordinates_m[0]))
    attributes = {
        "geometry": np.bytes_("cartesian"),
        "dataOrder": np.bytes_("C"),
        "axisLabels": np.array([b"x", b"y", b"z"]),
        "gridSpacing": np.array(spacings_m),
        "gridGlobalOffset": np.array(offsets_m),
        "gridUnitSI": np.float64(1.0),
        "timeOffset": np.float64(0.0),
    }
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        _describe(file, request)
        iteration = file.create_group(BASE.replace("%T", "0"))
        iteration.attrs.update(
            {"time": np.float64(0.0), "dt": np.float64(1.0), "timeUnitSI": np.float64(1.0)}
        )
        entries = {
            "".join(pair): gradient[..., "xyz".index(pair[0]), "xyz".index(pair[1])]
            for pair in product("xyz", "xyz")
        }
        components = {axis: field_T[..., number] for number, axis in enumerate("xyz")}
        for name, arrays, unit in (("B", components, TESLA), ("gradB", entries, TESLA_PER_METRE)):
            record = iteration.create_group(MESHES + name)
            record.attrs.update({**attributes, "unitDimension": np.array(unit)})
            for key, values in arrays.items():
                dataset = record.create_dataset(key, data=values)
                dataset.attrs.update({"unitSI": np.float64(1.0), "position": np.zeros(3)})
    return content.getvalue()


def _describe(file: h5py.File, request: Request) -> None:
    """Attributes that the standard requires at the top of a file."""
    texts = {
        "openPMD": VERSION,
        "basePath": BASE,
        "meshesPath": MESHES,
        "iterationEncoding": "groupBased",
        "iterationFormat": BASE,
        "software": "coilcal",
        "softwareVersion": code_version() or "unknown",
        "comment": f"{request.words}; world frame; {request.magnet.origin}",
    }
    file.attrs.update({key: np.bytes_(text.encode("ascii", "replace")) for key, text in texts.items()})
    file.attrs["openPMDextension"] = np.uint32(0)

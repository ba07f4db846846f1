"""The posterior as NetCDF with ArviZ's groups, so that any program that reads NetCDF 4 or HDF5 has draws, readings and units."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr

from estimator.code_version import code_version
from estimator.errors import InvalidInput
from estimator.export.request import Request
from estimator.rig_files.write import rig_text
from estimator.store.arrays import observation_arrays

ENGINE: Literal["h5netcdf"] = "h5netcdf"  # comes with ArviZ


def netcdf(request: Request) -> bytes:
    """A file with groups `posterior`, `sample_stats`, `observed_data` and `constant_data`; draws carry their units.

    Raises:
        InvalidInput: No parameter is free, so there is no posterior.
    """
    calibrated = request.calibrated
    if not calibrated.draws:
        raise InvalidInput(
            f"export to arviz must have a free parameter; rig {calibrated.rig.name!r} has none"
        )
    walkers, steps = calibrated.log_prob.shape
    coords = {"chain": np.arange(walkers), "draw": np.arange(steps)}
    units = {name: calibrated.rig.parameters[name].unit for name in calibrated.draws}
    posterior = {
        name: (("chain", "draw"), draws, {"units": units[name]}) for name, draws in calibrated.draws.items()
    }
    arrays = observation_arrays(calibrated.observations)
    attributes = {"inference_library": "emcee", "code_version": code_version() or ""}
    tree = xr.DataTree.from_dict(
        {
            "/": xr.Dataset(attrs={"rig": rig_text(calibrated.rig), "creation_library": "coilcal"}),
            "/posterior": xr.Dataset(posterior, coords, attributes),
            "/sample_stats": xr.Dataset({"lp": (("chain", "draw"), calibrated.log_prob)}, coords),
            "/observed_data": xr.Dataset({"field_sensor_T": arrays.pop("field_sensor_T")}),
            "/constant_data": xr.Dataset(arrays),
        }
    )
    with tempfile.TemporaryDirectory() as folder:  # older xarray writes trees to a path only
        path = Path(folder) / "posterior.nc"
        tree.to_netcdf(path, engine=ENGINE)
        return path.read_bytes()

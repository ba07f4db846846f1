"""The posterior as NetCDF with ArviZ's groups, so that any program that reads NetCDF 4 or HDF5 has draws, readings and units."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import xarray as xr

from estimator.code_version import code_version
from estimator.effects.use import as_meant
from estimator.errors import InvalidInput
from estimator.export.calibrated import Calibrated
from estimator.export.request import Request
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.flags import COMPONENTS
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.rig_files.write import rig_text
from estimator.store.arrays import observation_arrays

PRIOR_DRAWS = 1000
PREDICTIONS = 400  # draws of the posterior, evenly spaced, that readings are predicted by
AT_ONCE = 2**22  # predicted components
UNITS = {"T": "T", "A": "A", "s": "s", "C": "degC"}  # by the end of a name
LONG_NAMES = {
    "time_s": "time of the reading",
    "current_A": "current of each coil, commanded or measured",
    "field_sensor_T": "flux density in the frame of the sensor",
    "is_validation": "whether the reading was kept out of the fit",
    "sensor_index": "number of the sensor in the rig, from 0",
    "repeat": "number of the repeat of a setting",
    "current_measured_A": "current that the supplies measured",
    "segment": "number of the file, day or plane before which everything was set up anew",
}
NO_UNITS = {"sensor_index", "repeat", "segment", "is_validation"}
COMPONENT: Mapping[str, Any] = {"component": list(COMPONENTS)}
Variable = tuple[tuple[str, ...], Any, dict[str, str]]

ENGINE: Literal["h5netcdf"] = "h5netcdf"  # comes with ArviZ


def netcdf(request: Request) -> bytes:
    """A file with ArviZ's groups from prior to log likelihood; numbers carry their units and what they are in words.

    `posterior` and `sample_stats` have all draws. `posterior_predictive` predicts all readings, with noise, by some hundred of them;
    `log_likelihood` has each measured component of the readings that were fitted, as `arviz.loo` takes it.

    Raises:
        InvalidInput: No parameter is free, so there is no posterior.
    """
    calibrated = request.calibrated
    if not calibrated.draws:
        raise InvalidInput(
            f"export to arviz must have a free parameter; rig {calibrated.rig.name!r} has none"
        )
    rig, (walkers, steps) = calibrated.rig, calibrated.log_prob.shape
    coords = {"chain": np.arange(walkers), "draw": np.arange(steps)}
    posterior = {name: (("chain", "draw"), draws, _of(rig, name)) for name, draws in calibrated.draws.items()}
    attributes = {"inference_library": "emcee", "code_version": code_version() or ""}
    readings, bodies = _readings(rig, calibrated.observations)
    predictive, likelihood = _predictions(
        calibrated, np.linspace(0, steps - 1, max(1, PREDICTIONS // walkers))
    )
    log_density = {"long_name": "log posterior density"}
    tree = xr.DataTree.from_dict(
        {
            "/": xr.Dataset(attrs={"rig": rig_text(rig), "creation_library": "coilcal"}),
            "/posterior": xr.Dataset(posterior, coords, attributes),
            "/sample_stats": xr.Dataset(
                {"lp": (("chain", "draw"), calibrated.log_prob, log_density)}, coords
            ),
            "/prior": _prior(rig),
            "/posterior_predictive": predictive,
            "/log_likelihood": likelihood,
            "/observed_data": xr.Dataset({"field_sensor_T": readings.pop("field_sensor_T")}, COMPONENT),
            "/constant_data": xr.Dataset(readings, bodies),
        }
    )
    with tempfile.TemporaryDirectory() as folder:  # older xarray writes trees to a path only
        path = Path(folder) / "posterior.nc"
        tree.to_netcdf(path, engine=ENGINE)
        return path.read_bytes()


def _of(rig: Rig, name: str) -> dict[str, str]:
    """Unit of a number of the rig, and its name in words."""
    body, _, quantity = name.rpartition(".")
    words = " ".join(quantity.split("_")[: -1 if rig.parameters[name].unit != "1" else None])
    return {"units": rig.parameters[name].unit, "long_name": f"{words} of {body}"}


def _prior(rig: Rig) -> xr.Dataset:
    """Draws of each number from its prior alone."""
    coordinates = Coordinates(rig, integer_counts=True)
    values = coordinates.values(coordinates.sample_prior(np.random.default_rng(0), PRIOR_DRAWS))
    draws = {
        name: (("chain", "draw"), values[name].numpy()[None], _of(rig, name)) for name in coordinates.names
    }
    return xr.Dataset(draws, {"chain": [0], "draw": np.arange(PRIOR_DRAWS)})


def _readings(rig: Rig, observations: Observations) -> tuple[dict[str, Variable], dict[str, Any]]:
    """Readings with their units, and the names of what their axes count."""
    arrays: dict[str, Variable] = {}
    coords: dict[str, Any] = {"coil": [coil.name for coil in rig.coils]}
    for name, (dimensions, values) in observation_arrays(observations).items():
        ending = name.rpartition("_")[2]
        told = {"units": UNITS[ending]} if ending in UNITS and name not in NO_UNITS else {}
        if name.startswith("motion_"):
            mover = name.removeprefix("motion_")
            (coords[f"column_{mover}"],) = (list(each.columns) for each in rig.movers if each.name == mover)
            arrays[name] = (
                ("reading", f"column_{mover}"),
                values,
                {"long_name": f"pose of {mover}, by column"},
            )
            continue
        if name.startswith("temperature_"):
            told["long_name"] = f"temperature of {name.removeprefix('temperature_').removesuffix('_C')}"
        arrays[name] = (
            dimensions,
            values,
            told | ({"long_name": LONG_NAMES[name]} if name in LONG_NAMES else {}),
        )
    return arrays, coords


def _predictions(calibrated: Calibrated, steps: np.ndarray) -> tuple[xr.Dataset, xr.Dataset]:
    """Readings as some draws predict them, noise included, and the log likelihood of each component that was fitted."""
    rig, draw = calibrated.rig, steps.astype(int)
    readings = as_meant(rig, calibrated.observations)
    coordinates = Coordinates(rig, integer_counts=True)
    chosen = {name: torch.from_numpy(draws[:, draw].reshape(-1)) for name, draws in calibrated.draws.items()}
    vector = coordinates.vector(chosen)
    everywhere = readings.with_field(torch.zeros_like(readings.field_sensor_T))  # each component is predicted
    generator = torch.Generator().manual_seed(0)
    predicted, density = [], []
    fitted, is_fitted = readings.calibration, readings.is_measured & ~readings.is_validation[:, None]
    of_all, of_fitted = (
        LogPosterior(coordinates, MeasurementModel.build(rig, some), some) for some in (everywhere, fitted)
    )
    for some in vector.split(max(1, AT_ONCE // (3 * len(readings)))):
        with torch.no_grad():
            noise = torch.randn(len(some), 3 * len(readings), generator=generator, dtype=some.dtype)
            share, ratio = of_all.contamination(coordinates.values(some))
            is_wild = torch.rand(noise.shape, generator=generator, dtype=some.dtype) < share
            error_T = of_all.component_sigma_T(some) * noise * torch.where(is_wild, ratio, 1.0)
            predicted.append(of_all.predicted(some) + error_T)
            density.append(of_fitted.component_log_density(some))
    shape = (calibrated.log_prob.shape[0], len(draw))
    coords = {"chain": np.arange(shape[0]), "draw": draw}
    field_T = torch.cat(predicted).reshape(*shape, len(readings), 3).numpy()
    reading, component = is_fitted.nonzero().unbind(1)
    axes = {"reading": ("measured", reading), "axis": ("measured", np.array(COMPONENTS)[component])}
    told = {"units": "T", "long_name": "predicted flux density in the frame of the sensor, with noise"}
    each = {"long_name": "log likelihood of each measured component, of a density per T"}
    return (
        xr.Dataset(
            {"field_sensor_T": (("chain", "draw", "reading", "component"), field_T, told)},
            {**coords, **COMPONENT},
        ),
        xr.Dataset(
            {
                "field_sensor_T": (
                    ("chain", "draw", "measured"),
                    torch.cat(density).reshape(*shape, -1).numpy(),
                    each,
                )
            },
            coords | axes,
        ),
    )

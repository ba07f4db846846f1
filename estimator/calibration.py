"""A calibrated model: the field anywhere, with credible intervals, and a place on disk."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import xarray as xr
from jaxtyping import Float
from torch import Tensor

from estimator.config import rig_from_text
from estimator.coordinates import Coordinates
from estimator.errors import CorruptStore, InvalidInput
from estimator.prediction import RoomField
from estimator.records import Observations
from estimator.rig import Rig
from estimator.store.session import observation_arrays, observations_from

SCHEMA_VERSION = 1
POSTERIOR, SUMMARY = "posterior.zarr", "summary.json"
INTERVAL_DRAWS = 400


@dataclass(frozen=True)
class Calibration:
    """The result of a calibration.

    Attributes:
        rig: The rig with its priors.
        observations: The readings it was made from, validation included.
        best: Every number of the rig at the posterior's maximum, with the most probable whole loop counts.
        draws: Posterior draws of every free parameter, walker by step.
        log_prob: Log posterior density of the draws, up to a constant.
        record: The content of `summary.json`.
    """

    rig: Rig
    observations: Observations
    best: Mapping[str, float]
    draws: Mapping[str, np.ndarray]
    log_prob: np.ndarray
    record: Mapping[str, Any]

    def field(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> Float[Tensor, "point 3"]:
        """Flux density of the calibrated model in the world frame, in tesla.

        Args:
            points_m: Points in the world frame.
            currents_A: Current of each coil by name; coils that are not named are off.
            motion: Per mover the six numbers of its columns; zeros (the reference configuration) where absent.
        Returns: Bx, By, Bz; NaN at points inside a winding.
        Raises:
            InvalidInput: An unknown coil or mover.
        """
        best = self._best()
        return RoomField(self.rig, best, points_m, motion).field_T(best, self._currents(currents_A))

    def gradient(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> Float[Tensor, "point 3 3"]:
        """dB_i / dx_j of the calibrated model in the world frame, in T/m; symmetric and traceless, as in any source-free place."""
        best = self._best()
        return RoomField(self.rig, best, points_m, motion).gradient_T_per_m(best, self._currents(currents_A))

    def field_interval(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3"]]:
        """Credible interval of each field component: what the data and priors leave open about the model.

        Args:
            points_m, currents_A, motion: As in `field`.
            level: Probability inside the interval, 0 < level < 1.
        Returns: Lower and upper ends, in tesla, from 400 draws of the posterior.
        Raises:
            InvalidInput: Level outside (0, 1), an unknown coil or mover.
        """
        if not 0.0 < level < 1.0:
            raise InvalidInput(f"level must lie between 0 and 1; received {level}")
        room = RoomField(self.rig, self._best(), points_m, motion)
        fields = room.field_T(self.draw_values(INTERVAL_DRAWS), self._currents(currents_A))
        tails = torch.tensor([0.5 - 0.5 * level, 0.5 + 0.5 * level], dtype=fields.dtype)
        lower, upper = torch.quantile(fields, tails, dim=0)
        return lower, upper

    def draw_values(self, most: int) -> dict[str, Tensor]:
        """Every number of the rig for evenly spaced draws of the posterior, in the order of the steps."""
        flat = {name: array.T.reshape(-1) for name, array in self.draws.items()}
        n = len(self.log_prob.reshape(-1))
        index = np.linspace(0, n - 1, min(most, n)).astype(int)
        coordinates = Coordinates(self.rig, integer_counts=True)
        return coordinates.values(
            coordinates.vector({k: torch.from_numpy(v[index]) for k, v in flat.items()})
        )

    def summary(self) -> Mapping[str, Any]:
        """Parameters with credible intervals, loop counts, errors, coverage and provenance: the content of `summary.json`."""
        return self.record

    def save(self, folder: Path | str) -> None:
        """Write `posterior.zarr` (ArviZ groups for `xarray.open_datatree`); `summary.json` comes last and marks a whole result."""
        folder = Path(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            partial = folder / (POSTERIOR + ".partial")
            shutil.rmtree(partial, ignore_errors=True)
            self._write_posterior(partial)
            shutil.rmtree(folder / POSTERIOR, ignore_errors=True)
            partial.rename(folder / POSTERIOR)
            write_text(
                folder / SUMMARY, json.dumps(self.record, indent=2, sort_keys=True, allow_nan=False) + "\n"
            )
        except OSError as error:
            raise InvalidInput(f"output must be writable; {folder} is not: {error}") from error

    @classmethod
    def load(cls, folder: Path | str) -> Calibration:
        """Read what `save` wrote.

        Raises:
            InvalidInput: No finished calibration in this folder.
            CorruptStore: A file in it is damaged.
        """
        folder = Path(folder)
        if not (folder / SUMMARY).is_file():
            raise InvalidInput(f"calibration must be a folder with {SUMMARY}; received {folder}")
        try:
            record = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
            with xr.open_datatree(folder / POSTERIOR, engine="zarr", consolidated=False) as tree:
                draws = {str(name): array.to_numpy() for name, array in tree["posterior"].data_vars.items()}
                log_prob = tree["sample_stats/lp"].to_numpy()
                arrays = {
                    str(name): array.to_numpy() for name, array in tree["constant_data"].data_vars.items()
                }
                arrays |= {
                    str(name): array.to_numpy() for name, array in tree["observed_data"].data_vars.items()
                }
                attributes = dict(tree["posterior"].attrs)
            rig = rig_from_text(attributes["rig"], f"rig inside {folder}")
            rig = rig.with_values(
                {k: v for k, v in json.loads(attributes["nominal"]).items() if rig.parameters[k].tie is None}
            )
            return cls(
                rig, observations_from(arrays, rig), json.loads(attributes["best"]), draws, log_prob, record
            )
        except InvalidInput:
            raise
        except Exception as error:  # whatever zarr, JSON or NumPy make of damaged bytes
            raise CorruptStore(
                f"calibration must be readable; {folder} is damaged: {type(error).__name__} {error}"
            ) from error

    def _write_posterior(self, path: Path) -> None:
        walkers, steps = self.log_prob.shape
        coords = {"chain": np.arange(walkers), "draw": np.arange(steps)}
        attributes = {
            "schema_version": SCHEMA_VERSION,
            "rig": self.rig.text,
            "nominal": json.dumps(self.rig.nominal_values()),
            "best": json.dumps(dict(self.best)),
            "inference_library": "emcee",
        }
        posterior = xr.Dataset({k: (("chain", "draw"), v) for k, v in self.draws.items()}, coords, attributes)
        stats = xr.Dataset({"lp": (("chain", "draw"), self.log_prob)}, coords)
        arrays = observation_arrays(self.observations)
        tree = xr.DataTree.from_dict(
            {
                "/posterior": posterior,
                "/sample_stats": stats,
                "/observed_data": xr.Dataset({"field_sensor_T": arrays.pop("field_sensor_T")}),
                "/constant_data": xr.Dataset(arrays),
            }
        )
        tree.to_zarr(path, mode="w", zarr_format=3, consolidated=False)

    def _best(self) -> dict[str, Tensor]:
        return {name: torch.tensor(value, dtype=torch.float64) for name, value in self.best.items()}

    def _currents(self, currents_A: Mapping[str, float]) -> Float[Tensor, " coil"]:
        names = [coil.name for coil in self.rig.coils]
        for name in currents_A:
            if name not in names:
                raise InvalidInput(
                    f"currents must name coils of the rig ({', '.join(names)}); received {name!r}"
                )
        return torch.tensor([float(currents_A.get(name, 0.0)) for name in names], dtype=torch.float64)


def write_text(path: Path, text: str) -> None:
    """Replace a file whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    with partial.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)

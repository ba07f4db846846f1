"""Calibrated models at a service, read as `estimator.Calibration` is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from dataclasses import field as attribute
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.client.calls import Awaits, Call, Waits
from estimator.client.connection import Http
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.staging import write_output

if TYPE_CHECKING:
    import pyarrow as pa

    from estimator.export.request import Grid

Axis = tuple[float, float, int]
AT_ZERO: Axis = (0.0, 0.0, 1)
Currents = Mapping[str, float]
Points = Float[Tensor, "point 3"]
Gradients = Float[Tensor, "point 3 3"]
Motion = Mapping[str, Float[Tensor, " 6"]]
Own = TypeVar("Own", bound="CalibrationCalls")


@dataclass(frozen=True)
class CalibrationCalls:
    """A calibrated model at a service; points inside a winding are NaN.

    Attributes:
        id: Id of the calibration at the service.
        summary_json: Content of its `summary.json`.
        connection: To the service.
        is_of_coils_alone: Whether predictions and exports leave out what is there without current.
    """

    id: str
    summary_json: Mapping[str, Any] = attribute(repr=False)
    connection: Http = attribute(repr=False)
    is_of_coils_alone: bool = False

    def summary(self) -> Mapping[str, Any]:
        """The content of `summary.json`."""
        return self.summary_json

    @property
    def best(self) -> Mapping[str, float]:
        """Every number of the rig at the maximum of the posterior."""
        return dict(self.summary_json["best"])

    def coils_alone(self: Own) -> Own:
        """This calibration without what is there without current, such as the Earth's field; as `estimator.Calibration.coils_alone`.

        Predictions and exports change; `rig` and `summary` stay those that were fitted.
        """
        return replace(self, is_of_coils_alone=True)

    @Call
    async def field(self, points_m: Points, currents_A: Currents, motion: Motion | None = None) -> Points:
        """Flux density in the world frame, in tesla; as `estimator.Calibration.field`."""
        asked = {"has_intervals": False}
        return (await self._predicted(points_m, currents_A, motion, asked))["field_T"]

    @Call
    async def gradient(
        self, points_m: Points, currents_A: Currents, motion: Motion | None = None
    ) -> Gradients:
        """dB_i / dx_j in the world frame, in T/m; as `estimator.Calibration.gradient`."""
        asked = {"has_field": False, "has_gradient": True, "has_intervals": False}
        return (await self._predicted(points_m, currents_A, motion, asked))["gradient_T_per_m"]

    @Call
    async def field_interval(
        self, points_m: Points, currents_A: Currents, level: float = 0.9, motion: Motion | None = None
    ) -> tuple[Points, Points]:
        """Credible interval of each field component; as `estimator.Calibration.field_interval`."""
        answer = await self._predicted(points_m, currents_A, motion, {"level": level})
        return answer["field_lower_T"], answer["field_upper_T"]

    @Call
    async def gradient_interval(
        self, points_m: Points, currents_A: Currents, level: float = 0.9, motion: Motion | None = None
    ) -> tuple[Gradients, Gradients]:
        """Credible interval of each dB_i / dx_j; as `estimator.Calibration.gradient_interval`."""
        asked = {"has_field": False, "has_gradient": True, "level": level}
        answer = await self._predicted(points_m, currents_A, motion, asked)
        return answer["gradient_lower_T_per_m"], answer["gradient_upper_T_per_m"]

    @Call
    async def grid(
        self,
        currents_A: Currents,
        level: float = 0.9,
        motion: Motion | None = None,
        *,
        x: Axis = AT_ZERO,
        y: Axis = AT_ZERO,
        z: Axis = AT_ZERO,
        has_gradient: bool = False,
    ) -> pa.Table:
        """Field, and gradient if wanted, with credible intervals on a regular grid of the world frame.

        Args:
            currents_A, level, motion: As in `field_interval`.
            x, y, z: First and last coordinate in metres, and how many there are.
            has_gradient: With dB_i / dx_j.
        Returns: An Arrow table with a row for each point, z changing fastest: `x_m`, `Bx_T`, `Bx_lower_T`, and so on; null inside a
            winding. Its `to_pandas()` is a data frame.
        Raises:
            ModuleNotFoundError: pyarrow is missing; `pip install pyarrow`.
        """
        import pyarrow as pa  # only here, for it is larger than all else that a client needs

        body: dict[str, Any] = {
            name: {"first_m": first_m, "last_m": last_m, "n": n}
            for name, (first_m, last_m, n) in {"x": x, "y": y, "z": z}.items()
        }
        body |= {**self._wish(currents_A, motion), "level": level, "has_gradient": has_gradient}
        answer = await self.connection.send("POST", f"{self._path}/grid.arrow", json=body)
        return pa.ipc.open_stream(answer.content).read_all()

    @Call
    async def export(
        self,
        to: str,
        path: Path | str | None = None,
        *,
        grid: Grid | None = None,
        currents_A: Currents | None = None,
        motion: Motion | None = None,
    ) -> Path:
        """Write the model for other programs; as `estimator.Calibration.export`.

        Raises:
            InvalidInput: As there, or the file cannot be written.
        """
        body: dict[str, Any] = {"to": to, **self._wish(currents_A or {}, motion)}
        if grid is not None:
            axes: Mapping[str, Any] = {"x_m": grid.x_m, "y_m": grid.y_m, "z_m": grid.z_m}
            body["grid"] = {name: coordinates_m.tolist() for name, coordinates_m in axes.items()}
        answer = await self.connection.send("POST", f"{self._path}/export", json=body)
        usual_name = Path(answer.headers["Content-Disposition"].partition('filename="')[2].rstrip('"')).name
        path = Path(usual_name if path is None else path)
        write_output(path, answer.content, overwrite=True)
        return path

    @property
    def _path(self) -> str:
        return f"/v1/calibrations/{self.id}"

    async def _rig(self) -> Rig:
        answer = await self.connection.send("GET", f"{self._path}/rig")
        return rig_from_text(answer.text, f"rig of calibration {self.id}")

    async def _predicted(
        self, points_m: Tensor, currents_A: Currents, motion: Motion | None, asked: Mapping[str, Any]
    ) -> dict[str, Tensor]:
        """What was asked for, as tensors."""
        body = {"points_m": points_m.tolist(), **self._wish(currents_A, motion), **asked}
        answer = await self.connection.json("POST", f"{self._path}/predict", json=body)
        answer.pop("caution", None)  # which `summary` has as `quality`
        return {name: torch.tensor(_nans(values), dtype=torch.float64) for name, values in answer.items()}

    def _wish(self, currents_A: Currents, motion: Motion | None) -> dict[str, Any]:
        motions = {name: values.tolist() for name, values in (motion or {}).items()}
        alone = {"is_of_coils_alone": True} if self.is_of_coils_alone else {}
        return {"currents_A": dict(currents_A), "motion": motions, **alone}


class RemoteCalibration(CalibrationCalls, Waits):
    """A calibrated model at a service."""

    @property
    def rig(self) -> Rig:
        """The rig with its priors."""
        return self.connection.run(self._rig())


class AsyncRemoteCalibration(CalibrationCalls, Awaits):
    """A calibrated model at a service, for `await`; methods as of `RemoteCalibration`."""

    async def rig(self) -> Rig:
        """The rig with its priors."""
        return await self._rig()


C = TypeVar("C", RemoteCalibration, AsyncRemoteCalibration)


async def calibration_of(kind: type[C], connection: Http, calibration_id: str) -> C:
    """A calibration that the service has."""
    summary = await connection.json("GET", f"/v1/calibrations/{calibration_id}/summary")
    return kind(calibration_id, summary, connection)


def _nans(values: Any) -> Any:
    """Numbers in nested lists, NaN in place of None."""
    if isinstance(values, list):
        return [_nans(value) for value in values]
    return math.nan if values is None else values

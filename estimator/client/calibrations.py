"""Calibrated models at a service, read as `estimator.Calibration` is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as attribute
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.client import predictions
from estimator.client.connection import AsyncConnection, Connection
from estimator.client.exports import exported
from estimator.client.predictions import AT_ZERO, Axis, Currents, Gradients, Motion, Points
from estimator.client.steps import Steps, send, send_json
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

if TYPE_CHECKING:
    import pyarrow as pa

    from estimator.export.request import Grid


@dataclass(frozen=True)
class CalibrationRecord:
    """What a client has of a calibration without asking again.

    Attributes:
        id: Id of the calibration at the service.
        summary_json: Content of its `summary.json`.
    """

    id: str
    summary_json: Mapping[str, Any] = attribute(repr=False)

    def summary(self) -> Mapping[str, Any]:
        """The content of `summary.json`."""
        return self.summary_json

    @property
    def best(self) -> Mapping[str, float]:
        """Every number of the rig at the maximum of the posterior."""
        return dict(self.summary_json["best"])


@dataclass(frozen=True)
class RemoteCalibration(CalibrationRecord):
    """A calibrated model at a service.

    Attributes:
        connection: To the service.
    """

    connection: Connection = attribute(repr=False)

    @property
    def rig(self) -> Rig:
        """The rig with its priors."""
        return self.connection.run(_rig(self.id))

    def field(self, points_m: Points, currents_A: Currents, motion: Motion | None = None) -> Points:
        """Flux density in the world frame, in tesla; as `estimator.Calibration.field`."""
        return self.connection.run(predictions.field(self.id, points_m, currents_A, motion))

    def gradient(self, points_m: Points, currents_A: Currents, motion: Motion | None = None) -> Gradients:
        """dB_i / dx_j in the world frame, in T/m; as `estimator.Calibration.gradient`."""
        return self.connection.run(predictions.gradient(self.id, points_m, currents_A, motion))

    def field_interval(
        self, points_m: Points, currents_A: Currents, level: float = 0.9, motion: Motion | None = None
    ) -> tuple[Points, Points]:
        """Credible interval of each field component; as `estimator.Calibration.field_interval`."""
        return self.connection.run(predictions.field_interval(self.id, points_m, currents_A, level, motion))

    def gradient_interval(
        self, points_m: Points, currents_A: Currents, level: float = 0.9, motion: Motion | None = None
    ) -> tuple[Gradients, Gradients]:
        """Credible interval of each dB_i / dx_j; as `estimator.Calibration.gradient_interval`."""
        return self.connection.run(
            predictions.gradient_interval(self.id, points_m, currents_A, level, motion)
        )

    def grid(
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
        axes = {"x": x, "y": y, "z": z}
        return self.connection.run(predictions.grid(self.id, currents_A, level, motion, axes, has_gradient))

    def export(
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
        return self.connection.run(exported(self.id, to, path, grid, currents_A, motion))


@dataclass(frozen=True)
class AsyncRemoteCalibration(CalibrationRecord):
    """A calibrated model at a service, for `await`; methods as of `RemoteCalibration`.

    Attributes:
        connection: To the service.
    """

    connection: AsyncConnection = attribute(repr=False)

    async def rig(self) -> Rig:
        """The rig with its priors."""
        return await self.connection.run(_rig(self.id))

    async def field(self, points_m: Points, currents_A: Currents, motion: Motion | None = None) -> Points:
        """Flux density in the world frame, in tesla."""
        return await self.connection.run(predictions.field(self.id, points_m, currents_A, motion))

    async def gradient(
        self, points_m: Points, currents_A: Currents, motion: Motion | None = None
    ) -> Gradients:
        """dB_i / dx_j in the world frame, in T/m."""
        return await self.connection.run(predictions.gradient(self.id, points_m, currents_A, motion))

    async def field_interval(
        self, points_m: Points, currents_A: Currents, level: float = 0.9, motion: Motion | None = None
    ) -> tuple[Points, Points]:
        """Credible interval of each field component."""
        return await self.connection.run(
            predictions.field_interval(self.id, points_m, currents_A, level, motion)
        )

    async def gradient_interval(
        self, points_m: Points, currents_A: Currents, level: float = 0.9, motion: Motion | None = None
    ) -> tuple[Gradients, Gradients]:
        """Credible interval of each dB_i / dx_j."""
        return await self.connection.run(
            predictions.gradient_interval(self.id, points_m, currents_A, level, motion)
        )

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
        """Field, and gradient if wanted, with credible intervals on a regular grid, as `RemoteCalibration.grid`."""
        axes = {"x": x, "y": y, "z": z}
        return await self.connection.run(
            predictions.grid(self.id, currents_A, level, motion, axes, has_gradient)
        )

    async def export(
        self,
        to: str,
        path: Path | str | None = None,
        *,
        grid: Grid | None = None,
        currents_A: Currents | None = None,
        motion: Motion | None = None,
    ) -> Path:
        """Write the model for other programs; as `RemoteCalibration.export`.

        Raises:
            InvalidInput: As there, or the file cannot be written.
        """
        return await self.connection.run(exported(self.id, to, path, grid, currents_A, motion))


def summary_of(calibration_id: str) -> Steps[tuple[str, dict[str, Any]]]:
    """A calibration that the service has: its id and the content of its `summary.json`."""
    summary = yield from send_json("GET", f"/v1/calibrations/{calibration_id}/summary")
    return calibration_id, summary


def _rig(calibration_id: str) -> Steps[Rig]:
    answer = yield from send("GET", f"/v1/calibrations/{calibration_id}/rig")
    return rig_from_text(answer.text, f"rig of calibration {calibration_id}")

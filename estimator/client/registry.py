"""The versions of a rig's calibration at a service."""

from __future__ import annotations

from typing import Any, ClassVar, Generic

from estimator.client.calibrations import AsyncRemoteCalibration, C, RemoteCalibration, calibration_of
from estimator.client.calls import Awaits, Call, Waits
from estimator.client.connection import Http, items_of
from estimator.errors import InvalidInput


class RegistryCalls(Generic[C]):
    """The versions of a rig's calibration at a service.

    Args:
        connection: To the service.
        rig_id: Any version of the rig.
    """

    _calibration: ClassVar[type[Any]]

    def __init__(self, connection: Http, rig_id: str) -> None:
        self.connection, self._path = connection, f"/v1/rigs/{rig_id}/registry"

    @Call
    async def calibration(self) -> C:
        """The current version.

        Raises:
            InvalidInput: There is none.
        """
        calibration_id = (await self.connection.json("GET", self._path))["calibration_id"]
        if calibration_id is None:
            raise InvalidInput("registry must have a version; it has none")
        return await calibration_of(self._calibration, self.connection, str(calibration_id))

    @Call
    async def versions(self) -> list[dict[str, Any]]:
        """Every version with its parameters, newest first."""
        return [item async for item in items_of(self.connection, f"{self._path}/versions", {})]

    @Call
    async def entries(self) -> list[dict[str, Any]]:
        """Conclusions and rollbacks, newest first."""
        return [item async for item in items_of(self.connection, f"{self._path}/entries", {})]

    @Call
    async def roll_back(self, version: int) -> dict[str, Any]:
        """Make an earlier version current again; the entry of the log."""
        return await self.connection.json("POST", f"{self._path}/roll-back", json={"version": version})

    async def _current(self) -> int | None:
        number = (await self.connection.json("GET", self._path))["current"]
        return None if number is None else int(number)


class RemoteRegistry(RegistryCalls[RemoteCalibration], Waits):
    """The versions of a rig's calibration at a service."""

    _calibration = RemoteCalibration

    @property
    def current(self) -> int | None:
        """Number of the version in use; None before the first."""
        return self.connection.run(self._current())


class AsyncRemoteRegistry(RegistryCalls[AsyncRemoteCalibration], Awaits):
    """The versions of a rig's calibration at a service, for `await`; arguments and methods as of `RemoteRegistry`."""

    _calibration = AsyncRemoteCalibration

    async def current(self) -> int | None:
        """Number of the version in use; None before the first."""
        return await self._current()

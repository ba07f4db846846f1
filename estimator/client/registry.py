"""The versions of a rig's calibration at a service."""

from __future__ import annotations

from typing import Any

from estimator.client.calibrations import AsyncRemoteCalibration, RemoteCalibration, summary_of
from estimator.client.connection import AsyncConnection, Connection
from estimator.client.lists import whole_list
from estimator.client.steps import Steps, send_json
from estimator.errors import InvalidInput


class RemoteRegistry:
    """The versions of a rig's calibration at a service.

    Args:
        connection: To the service.
        rig_id: Any version of the rig.
    """

    def __init__(self, connection: Connection, rig_id: str) -> None:
        self._connection, self._path = connection, _path(rig_id)

    @property
    def current(self) -> int | None:
        """Number of the version in use; None before the first."""
        return self._connection.run(_current(self._path))

    def calibration(self) -> RemoteCalibration:
        """The current version.

        Raises:
            InvalidInput: There is none.
        """
        return RemoteCalibration(*self._connection.run(_calibration(self._path)), self._connection)

    def versions(self) -> list[dict[str, Any]]:
        """Every version with its parameters, newest first."""
        return self._connection.run(whole_list(f"{self._path}/versions"))

    def entries(self) -> list[dict[str, Any]]:
        """Conclusions and rollbacks, newest first."""
        return self._connection.run(whole_list(f"{self._path}/entries"))

    def roll_back(self, version: int) -> dict[str, Any]:
        """Make an earlier version current again; the entry of the log."""
        return self._connection.run(_roll_back(self._path, version))


class AsyncRemoteRegistry:
    """The versions of a rig's calibration at a service, for `await`; arguments and methods as of `RemoteRegistry`."""

    def __init__(self, connection: AsyncConnection, rig_id: str) -> None:
        self._connection, self._path = connection, _path(rig_id)

    async def current(self) -> int | None:
        """Number of the version in use; None before the first."""
        return await self._connection.run(_current(self._path))

    async def calibration(self) -> AsyncRemoteCalibration:
        """The current version."""
        return AsyncRemoteCalibration(*await self._connection.run(_calibration(self._path)), self._connection)

    async def versions(self) -> list[dict[str, Any]]:
        """Every version with its parameters, newest first."""
        return await self._connection.run(whole_list(f"{self._path}/versions"))

    async def entries(self) -> list[dict[str, Any]]:
        """Conclusions and rollbacks, newest first."""
        return await self._connection.run(whole_list(f"{self._path}/entries"))

    async def roll_back(self, version: int) -> dict[str, Any]:
        """Make an earlier version current again; the entry of the log."""
        return await self._connection.run(_roll_back(self._path, version))


def _path(rig_id: str) -> str:
    return f"/v1/rigs/{rig_id}/registry"


def _current(path: str) -> Steps[int | None]:
    number = (yield from send_json("GET", path))["current"]
    return None if number is None else int(number)


def _calibration(path: str) -> Steps[tuple[str, dict[str, Any]]]:
    calibration_id = (yield from send_json("GET", path))["calibration_id"]
    if calibration_id is None:
        raise InvalidInput("registry must have a version; it has none")
    return (yield from summary_of(str(calibration_id)))


def _roll_back(path: str, version: int) -> Steps[dict[str, Any]]:
    return (yield from send_json("POST", f"{path}/roll-back", json={"version": version}))

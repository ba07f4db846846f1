"""Serves the ports of a simulated Universal Robots controller: RTDE (30004), dashboard (29999) and script (30003).

Clients cannot choose other ports, so each arm gets its own address, 127.x.y.z.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Protocol

from drivers.children import run_ahead
from drivers.errors import DeviceFault
from drivers.robots import rtde
from drivers.robots.rtde import Package, PackageType, Recipe
from drivers.simulated.faults import Fault, FaultSwitch
from drivers.simulated.process import exit_with_parent
from drivers.simulated.ur_controller import UrController, kind_of
from drivers.simulated.world import World

DASHBOARD_PORT, SCRIPT_PORT = 29999, 30003
_SAFETY_STOPS = {
    Fault.PROTECTIVE_STOP: UrController.protective_stop,
    Fault.EMERGENCY_STOP: UrController.emergency_stop,
}

_LONGEST_BACKLOG_S = 0.5
_CYCLE_S = 0.002


class _Client(Protocol):
    def take(self, data: bytes) -> bytes: ...


@dataclass
class _RtdeClient:
    controller: UrController
    arrived: bytes = b""
    outputs: Recipe | None = None
    period_s: float = 0.002
    inputs: list[Recipe] = field(default_factory=list)
    is_started: bool = False
    next_s: float = 0.0

    def take(self, data: bytes) -> bytes:
        packages, self.arrived = rtde.split(self.arrived + data)
        return b"".join(rtde.encode(answer) for package in packages for answer in self._answer(package))

    def due(self) -> bytes:
        """The data packages due since the last call; those of a long pause are skipped."""
        now_s = time.monotonic()
        if not self.is_started or self.outputs is None:
            return b""
        if now_s - self.next_s > _LONGEST_BACKLOG_S:
            self.next_s = now_s
        packages = []
        while self.next_s <= now_s:
            values = self.controller.outputs(self.outputs.names, self.next_s)
            packages.append(rtde.encode(rtde.encode_data(self.outputs, values)))
            self.next_s += self.period_s
        return b"".join(packages)

    def _answer(self, package: Package) -> list[Package]:
        kind, payload = package.type, package.payload
        if kind is PackageType.DATA:
            recipe = self.inputs[payload[0] - 1]
            self.controller.set_inputs(recipe.names, list(rtde.decode_data(payload, recipe).values()))
            return []
        if kind is PackageType.GET_CONTROLLER_VERSION:
            numbers = [int(part) for part in self.controller.version.split(".")]
            return [Package(kind, struct.pack(">4I", *numbers))]
        if kind is PackageType.SET_UP_OUTPUTS:
            self.period_s = 1 / struct.unpack(">d", payload[:8])[0]
            names = _names(payload[8:])
            self.outputs = Recipe(1, names, tuple(kind_of(name) for name in names))
            return [Package(kind, b"\x01" + ",".join(self.outputs.types).encode("ascii"))]
        if kind is PackageType.SET_UP_INPUTS:
            names = _names(payload)
            recipe = Recipe(len(self.inputs) + 1, names, tuple(kind_of(name) for name in names))
            self.inputs.append(recipe)
            return [Package(kind, bytes([recipe.number]) + ",".join(recipe.types).encode("ascii"))]
        self.is_started = kind is PackageType.START or (self.is_started and kind is not PackageType.PAUSE)
        self.next_s = math.ceil(time.monotonic() / self.period_s) * self.period_s  # one beat for all clients
        return [Package(kind, b"\x01")]


@dataclass
class _LineClient:
    answer: Callable[[str], str]
    arrived: bytes = b""

    def take(self, data: bytes) -> bytes:
        *lines, self.arrived = (self.arrived + data).split(b"\n")
        return b"".join(f"{self.answer(line.decode('ascii', 'replace'))}\n".encode("ascii") for line in lines)


@dataclass
class _ScriptClient:
    controller: UrController
    arrived: bytes = b""

    def take(self, data: bytes) -> bytes:
        self.arrived += data
        while (end := self.arrived.find(b"\nend\n")) >= 0:
            self.controller.upload(self.arrived[:end].decode("utf-8", "replace"))
            self.arrived = self.arrived[end + 5 :]
        return b""


class _UrServer:
    """All connections of one controller, served by one loop like the real-time thread of a real one."""

    def __init__(self, controller: UrController, host: str) -> None:
        self._controller = controller
        self._servers: dict[socket.socket, Callable[[], _Client]] = {
            socket.create_server((host, rtde.PORT)): lambda: _RtdeClient(controller),
            socket.create_server((host, DASHBOARD_PORT)): lambda: _LineClient(controller.dashboard),
            socket.create_server((host, SCRIPT_PORT)): lambda: _ScriptClient(controller),
        }
        self._clients: dict[socket.socket, _Client] = {}

    def cycle(self, fault: Fault) -> None:
        """Serve what arrives until a package is due, or for a control cycle, then send the packages that are due."""
        now_s = time.monotonic()
        due_s = [
            client.next_s
            for client in self._clients.values()
            if isinstance(client, _RtdeClient) and client.is_started
        ]
        wait_s = max(0.0, min([now_s + _CYCLE_S, *due_s]) - now_s)
        for ready in select.select([*self._servers, *self._clients], [], [], wait_s)[0]:
            if ready in self._servers:
                self._accept(ready)
            else:
                self._serve(ready)
        self._controller.tick()
        for connection, client in list(self._clients.items()):
            if isinstance(client, _RtdeClient) and (packages := client.due()) and fault is not Fault.MUTE:
                self._send(connection, packages)

    def drop_rtde(self) -> None:
        """Break the RTDE connections."""
        for connection, client in list(self._clients.items()):
            if isinstance(client, _RtdeClient):
                self._drop(connection)

    def _accept(self, server: socket.socket) -> None:
        connection = server.accept()[0]
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[connection] = self._servers[server]()
        if isinstance(self._clients[connection], _LineClient):
            self._send(connection, b"Connected: Universal Robots Dashboard Server\n")

    def _serve(self, connection: socket.socket) -> None:
        try:
            data = connection.recv(65536)
            if not data:
                raise ConnectionResetError
            self._send(connection, self._clients[connection].take(data))
        except (OSError, DeviceFault):
            self._drop(connection)

    def _send(self, connection: socket.socket, data: bytes) -> None:
        try:
            connection.sendall(data)
        except OSError:
            self._drop(connection)

    def _drop(self, connection: socket.socket) -> None:
        self._clients.pop(connection, None)
        with contextlib.suppress(OSError):
            connection.close()


def _names(payload: bytes) -> tuple[str, ...]:
    return tuple(payload.decode("ascii").rstrip(",").split(","))


def serve_ur(world: World, arm: int, version: str, host: str, faults: FaultSwitch, ready: Connection) -> None:
    """Main function of the simulator's process.

    Args:
        world: World of the rig.
        arm: Index of this arm in the world.
        version: Version of PolyScope, four numbers: 3.x for a UR3, 5.x for a UR3e.
        host: Address to listen on.
        faults: Fault to show.
        ready: Receives the address once the ports are open.
    """
    exit_with_parent()
    run_ahead()  # like the real-time thread of a real controller
    controller = UrController(world, arm, version=version, serial_number=f"2019530000{arm + 1}")
    server = _UrServer(controller, host)
    ready.send(host)
    ready.close()
    while True:
        fault = faults.fault
        if fault is Fault.STALL:
            time.sleep(_CYCLE_S)
            controller.tick()  # the arm goes on; only the network stalls
            continue
        if fault is Fault.DROP:
            server.drop_rtde()
            faults.fault = Fault.NONE
        elif fault in _SAFETY_STOPS:
            _SAFETY_STOPS[fault](controller)
            faults.fault = Fault.NONE
        server.cycle(fault)

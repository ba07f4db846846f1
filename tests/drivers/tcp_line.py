"""Simulated instruments behind TCP ports."""

from __future__ import annotations

import select
import socket
from functools import partial

from drivers.simulated.process import TICK_S, Simulator, serve


def on_tcp(make):
    """Start an instrument as `Simulator.on_serial_line` does, behind a TCP port."""
    return Simulator(partial(serve, make, TcpLine))


class TcpLine:
    """A TCP port that the system chooses."""

    outlives_drop = True

    def __init__(self):
        self._server = socket.create_server(("127.0.0.1", 0))
        self._client = None
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"

    def wait_for_data(self):
        if self._client is None:
            if select.select([self._server], [], [], TICK_S)[0]:
                self._client = self._server.accept()[0]
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        if not select.select([self._client], [], [], TICK_S)[0]:
            return b""
        try:
            data = self._client.recv(65536)
        except OSError:
            data = b""
        if not data:
            self.drop()
        return data

    def send(self, data):
        if self._client is None:
            return
        try:
            self._client.sendall(data)
        except OSError:
            self.drop()

    def drop(self):
        if self._client is not None:
            self._client.close()
            self._client = None

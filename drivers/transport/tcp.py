"""A TCP connection to an instrument, as a `Port`."""

from __future__ import annotations

import contextlib
import socket
import time

from drivers.deadline import Deadline
from drivers.errors import DeviceFault

_CHUNK = 65536


class TcpPort:
    """A `Port` over TCP; bytes are on their way when `send` returns, without Nagle's delay."""

    def __init__(self, host: str, port: int, *, timeout_s: float) -> None:
        """Connect.

        Raises:
            DeviceFault: No server listens there, or it did not answer in time.
        """
        self.name = f"{host}:{port}"
        self.arrived_s = time.monotonic()
        try:
            self._socket = socket.create_connection((host, port), timeout=timeout_s)
        except OSError as error:
            raise DeviceFault(f"{self.name} must accept a connection; {error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`."""
        try:
            self._socket.settimeout(max(1e-3, deadline.remaining_s))
            self._socket.sendall(data)
        except TimeoutError as error:
            raise deadline.exceeded(f"{self.name} must take what is sent", "its buffer stays full") from error
        except OSError as error:
            raise self._lost(str(error)) from error

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`."""
        try:
            self._socket.settimeout(deadline.remaining_s)
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError) as error:  # BlockingIOError if no time is left
            raise deadline.exceeded(f"{self.name} must receive", "nothing came") from error
        except OSError as error:
            raise self._lost(str(error)) from error
        if not data:
            raise self._lost("the other side closed it")
        self.arrived_s = time.monotonic()
        return data

    def close(self) -> None:
        """See `Port.close`."""
        with contextlib.suppress(OSError):  # no longer connected
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _lost(self, reason: str) -> DeviceFault:
        return DeviceFault(f"{self.name} must stay connected; {reason}")

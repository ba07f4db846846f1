"""Runs a simulated instrument in a child process, behind a pseudo-terminal or a TCP port."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable
from functools import cached_property, partial
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import Self

from drivers.children import SPAWN, start_without_main
from drivers.device import ClosesItself
from drivers.errors import DriverError
from drivers.simulated.faults import Fault, FaultSwitch, spoil
from drivers.simulated.instrument import Instrument

_TICK_S = 0.002
_START_S = 120.0
"""A simulator that fails is heard of at once; one whose field needs torch starts for half a minute on a busy computer."""
_SLOW_S = 0.01
_HANDSHAKE_S = 10.0
"""USB makes an instrument wait for its host, which may pause for seconds; a host that reads nothing for longer is gone."""


class Simulator(ClosesItself):
    """A running simulator; it ends when its `with` block or this process ends.

    Attributes:
        faults: Sets the simulator's fault; may be changed at any time.
    """

    def __init__(self, run: Callable[[FaultSwitch, Connection], None]) -> None:
        """Start the simulator.

        Args:
            run: Main function of the child process; sends its address once it listens.
        """
        self.faults = FaultSwitch()
        self._receiver, sender = SPAWN.Pipe(duplex=False)
        self._process = SPAWN.Process(target=run, args=(self.faults, sender), daemon=True)
        start_without_main(self._process)
        sender.close()

    @cached_property
    def address(self) -> str:
        """Path of the pseudo-terminal, `host:port`, or the host of an arm; waits until the simulator listens there.

        Raises:
            DriverError: It has ended, or does not listen.
        """
        try:
            if not self._receiver.poll(_START_S):
                raise DriverError(
                    f"a simulator must start within {_START_S:g} s; it has not (a busy computer?)"
                )
            return str(self._receiver.recv())
        except EOFError as error:
            raise DriverError("a simulator must start; it ended, see its error output") from error

    @classmethod
    def on_serial_line(cls, make: Callable[[], Instrument]) -> Self:
        """Start an instrument behind a pseudo-terminal.

        Args:
            make: Makes the instrument in the child process; the world is among its arguments (`functools.partial`).
        """
        return cls(partial(_serve_line, make, None))

    @classmethod
    def on_tcp(cls, make: Callable[[], Instrument], host: str = "127.0.0.1") -> Self:
        """Start an instrument behind a TCP port that the system chooses; `make` as above."""
        return cls(partial(_serve_line, make, host))

    @property
    def pid(self) -> int | None:
        """Process id of the simulator."""
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether the simulator is running."""
        return self._process.is_alive()

    def close(self) -> None:
        """End the simulator at once, as if its cable were pulled."""
        self._process.kill()
        self._process.join()


def exit_with_parent() -> None:
    """End this process when its parent has ended for any reason."""
    parent = parent_process()
    if parent is None:
        raise DriverError("a simulator must be started by another process; it has no parent")

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


class _PtyLine:
    def __init__(self) -> None:
        self._master, slave = os.openpty()
        # Stays open here too, so that the line outlives one client and waits for the next.
        self._slave = slave
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.address = os.ttyname(slave)

    def wait_for_data(self) -> bytes | None:
        """Bytes that arrived within a tick; None if the other side is gone."""
        if not select.select([self._master], [], [], _TICK_S)[0]:
            return b""
        try:
            return os.read(self._master, 65536)
        except OSError:
            return None

    def send(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._master, data) :]
            except BlockingIOError:
                # Wait, as on a line with handshake; if nobody reads at all, the rest is lost.
                if not select.select([], [self._master], [], _HANDSHAKE_S)[1]:
                    return

    def drop(self) -> None:
        os.close(self._slave)
        os.close(self._master)


class _TcpLine:
    def __init__(self, host: str) -> None:
        self._server = socket.create_server((host, 0))
        self._client: socket.socket | None = None
        self.address = f"{host}:{self._server.getsockname()[1]}"

    def wait_for_data(self) -> bytes | None:
        if self._client is None:
            if select.select([self._server], [], [], _TICK_S)[0]:
                self._client = self._server.accept()[0]
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        if not select.select([self._client], [], [], _TICK_S)[0]:
            return b""
        try:
            data = self._client.recv(65536)
        except OSError:
            data = b""
        if not data:
            self.drop()
        return data

    def send(self, data: bytes) -> None:
        if self._client is None:
            return
        try:
            self._client.sendall(data)
        except OSError:
            self.drop()

    def drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def _serve_line(
    make: Callable[[], Instrument], host: str | None, faults: FaultSwitch, ready: Connection
) -> None:
    exit_with_parent()
    instrument = make()
    line: _PtyLine | _TcpLine = _PtyLine() if host is None else _TcpLine(host)
    ready.send(line.address)
    ready.close()
    while True:
        if faults.fault is Fault.DROP:
            line.drop()
            if host is None:  # a closed pseudo-terminal does not come back
                return
            while faults.fault is Fault.DROP:
                time.sleep(_TICK_S)
        while faults.fault is Fault.STALL:
            time.sleep(_TICK_S)
        data = line.wait_for_data()
        if data is None:
            return
        answer = instrument.take(data) if data else b""
        for piece in spoil(answer + instrument.stream(), faults.fault):
            line.send(piece)
            if faults.fault is Fault.SLOW:
                time.sleep(_SLOW_S)

"""Runs a simulated instrument in a child process, behind a pseudo-terminal."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable
from functools import cached_property, partial
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import Protocol, Self

from drivers.children import SPAWN, start_without_main
from drivers.device import ClosesItself
from drivers.errors import DriverError
from drivers.simulated.faults import Fault, FaultSwitch, spoil
from drivers.simulated.instrument import Instrument

TICK_S = 0.002
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
        return cls(partial(serve, make, PtyLine))

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


class Line(Protocol):
    """A line between an instrument and its client.

    Attributes:
        address: Where clients reach it.
        outlives_drop: Whether it takes another client after it broke.
    """

    address: str
    outlives_drop: bool

    def wait_for_data(self) -> bytes | None:
        """Bytes that arrived within a tick; None if the other side is gone."""

    def send(self, data: bytes) -> None:
        """Send bytes, or lose them if nobody reads."""

    def drop(self) -> None:
        """Break the connection."""


class PtyLine:
    """See `Line`; a pseudo-terminal."""

    outlives_drop = False

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        # Stays open here too, so that the line outlives one client and waits for the next.
        self._slave = slave
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.address = os.ttyname(slave)

    def wait_for_data(self) -> bytes | None:
        """See `Line`."""
        if not select.select([self._master], [], [], TICK_S)[0]:
            return b""
        try:
            return os.read(self._master, 65536)
        except OSError:
            return None

    def send(self, data: bytes) -> None:
        """See `Line`."""
        while data:
            try:
                data = data[os.write(self._master, data) :]
            except BlockingIOError:
                # Wait, as on a line with handshake; if nobody reads at all, the rest is lost.
                if not select.select([], [self._master], [], _HANDSHAKE_S)[1]:
                    return

    def drop(self) -> None:
        """See `Line`."""
        os.close(self._slave)
        os.close(self._master)


def serve(
    make: Callable[[], Instrument], line_of: Callable[[], Line], faults: FaultSwitch, ready: Connection
) -> None:
    """Serve an instrument until its client is gone; main function of a child process.

    Args:
        make: Makes the instrument.
        line_of: Makes its line.
        faults: Fault to show.
        ready: Gets the address of the line.
    """
    exit_with_parent()
    instrument, line = make(), line_of()
    ready.send(line.address)
    ready.close()
    while True:
        if faults.fault is Fault.DROP:
            line.drop()
            if not line.outlives_drop:
                return
            while faults.fault is Fault.DROP:
                time.sleep(TICK_S)
        while faults.fault is Fault.STALL:
            time.sleep(TICK_S)
        data = line.wait_for_data()
        if data is None:
            return
        answer = instrument.take(data) if data else b""
        for piece in spoil(answer + instrument.stream(), faults.fault):
            line.send(piece)
            if faults.fault is Fault.SLOW:
                time.sleep(_SLOW_S)

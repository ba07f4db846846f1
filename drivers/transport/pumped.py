"""A port that a thread empties, for instruments that stream: the buffer of a serial line holds only milliseconds of the stream."""

from __future__ import annotations

import threading
import time
from collections import deque

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError
from drivers.transport.port import Port

_WAKE_S = 0.1
_MOST_BYTES = 50_000_000
"""Limit of what may wait: two minutes of the fastest stream here."""


class PumpedPort:
    """Buffers bytes with their arrival times until they are received."""

    def __init__(self, port: Port) -> None:
        self.name = port.name
        self.arrived_s = time.monotonic()
        self._port = port
        self._chunks: deque[tuple[float, bytes]] = deque()
        self._n_bytes = 0
        self._error: DriverError | None = None
        self._news = threading.Condition()
        self._is_closed = False
        self._thread = threading.Thread(target=self._pump, name=f"pump {port.name}", daemon=True)
        self._thread.start()

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`."""
        self._port.send(data, deadline)

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`; returns the bytes that arrived before an error, then raises it."""
        with self._news:
            self._news.wait_for(lambda: self._chunks or self._error, deadline.remaining_s)
            if self._chunks:
                self.arrived_s, data = self._chunks.popleft()
                self._n_bytes -= len(data)
                return data
            if self._error is not None:
                raise self._error
        raise deadline.exceeded(f"{self.name} must receive", "nothing came")

    def close(self) -> None:
        """See `Port.close`."""
        if not self._is_closed:
            self._is_closed = True
            self._thread.join()
            self._port.close()

    def _pump(self) -> None:
        while not self._is_closed:
            try:
                data = self._port.receive(Deadline.after(_WAKE_S))
            except DeadlineExceeded:
                continue
            except DriverError as error:
                self._end(error)
                return
            except Exception as error:  # no error of any kind may end the thread silently
                self._end(DeviceFault(f"{self.name} must be read; {error}"))
                return
            with self._news:
                self._chunks.append((self._port.arrived_s, data))
                self._n_bytes += len(data)
                self._news.notify_all()
            if self._n_bytes > _MOST_BYTES:
                self._end(
                    DeviceFault(
                        f"{self.name} must be read; {self._n_bytes} bytes are waiting, so the rest is lost"
                    )
                )
                return

    def _end(self, error: DriverError) -> None:
        with self._news:
            self._error = error
            self._news.notify_all()

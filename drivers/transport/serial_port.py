"""A serial port through pyserial, which also opens the pseudo-terminals of the simulators."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import termios
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import serial

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault

_LOG = logging.getLogger(__name__)

_WAKE_S = 0.01
"""Longest wait inside pyserial. Its timeout is set only once, because each change sets up the whole port anew."""


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Line settings of an instrument, as its manual prints them (`9600 7O1`).

    Attributes:
        baud: Bits per second.
        data_bits: Bits in a byte.
        parity: `N`one, `O`dd or `E`ven.
        has_rts_cts: Whether the hardware handshake is wired and obeyed.
    """

    baud: int
    data_bits: Literal[7, 8] = 8
    parity: Literal["N", "O", "E"] = "N"
    has_rts_cts: bool = False


class SerialPort:
    """A `Port` on a serial line, owned by this process alone (`exclusive`)."""

    def __init__(self, device: str, settings: SerialSettings) -> None:
        """Open the port.

        Raises:
            DeviceFault: The port is not there, not permitted, or owned by another process.
        """
        self.name = device
        self.arrived_s = time.monotonic()
        has_parity = not is_pseudo_terminal(device)
        try:
            # DTR and RTS keep the state that opening gives them: a pseudo-terminal refuses to set them.
            self._serial = serial.Serial(
                device,
                settings.baud,
                bytesize=settings.data_bits if has_parity else 8,
                parity=settings.parity if has_parity else "N",
                rtscts=settings.has_rts_cts,
                timeout=_WAKE_S,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            raise DeviceFault(f"{device} must open as a serial port; {error}") from error

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`."""
        # Not through pyserial: it has one timeout for all writes, and each change of it sets up the whole port anew.
        try:
            file = self._serial.fileno()
            while data:
                if not select.select([], [file], [], deadline.remaining_s)[1]:
                    raise deadline.exceeded(f"{self.name} must take what is sent", "its handshake says stop")
                with contextlib.suppress(BlockingIOError):
                    data = data[os.write(file, data) :]
        except DeadlineExceeded:
            raise
        except (OSError, ValueError) as error:
            raise self._lost(error) from error

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`."""
        while True:
            is_last = deadline.is_over
            try:
                waiting = int(self._serial.in_waiting)
                data = b"" if is_last and not waiting else bytes(self._serial.read(max(1, waiting)))
                if data and not waiting:  # more bytes may have followed the first
                    data += bytes(self._serial.read(self._serial.in_waiting))
            # TypeError: pyserial meets a file number of None if the port is closed meanwhile.
            except (OSError, TypeError) as error:
                raise self._lost(error) from error
            if data:
                self.arrived_s = time.monotonic()
                return data
            if is_last:
                raise deadline.exceeded(f"{self.name} must receive", "nothing came")

    def close(self) -> None:
        """See `Port.close`."""
        try:
            self._serial.close()
        except OSError as error:
            _LOG.warning("%s did not close cleanly: %s", self.name, error)

    def _lost(self, error: Exception) -> DeviceFault:
        return DeviceFault(f"{self.name} must stay connected; {error}")


def is_pseudo_terminal(device: str) -> bool:
    """Whether a device is a pseudo-terminal, which has no parity: a first request for it is ignored, a second one refused."""
    return Path(device).resolve().parent == Path("/dev/pts")

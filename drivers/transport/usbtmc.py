"""USB test-and-measurement instruments through the Linux kernel's own driver, a file such as /dev/usbtmc0.

Nothing to install, and no rights beyond those on the file (a udev rule). USBTMC has messages, not a stream of bytes: asking for an
answer that is not there is an error of the instrument, so this port only reads after a question.
"""

from __future__ import annotations

import fcntl
import os
import struct
import time

from drivers.deadline import Deadline
from drivers.errors import DeviceFault

_SET_TIMEOUT = 0x40045B0A
"""USBTMC_IOCTL_SET_TIMEOUT of linux/usb/tmc.h: _IOW(91, 10, __u32), milliseconds."""

_SHORTEST_MS = 100
"""The kernel refuses less (USBTMC_MIN_TIMEOUT)."""

_LONGEST_MESSAGE = 65536


class UsbtmcPort:
    """Messages of one instrument; the kernel lets one program have it at a time."""

    def __init__(self, path: str) -> None:
        """Open the device file.

        Raises:
            DeviceFault: It is not there, or not permitted.
        """
        self.name = path
        self.arrived_s = time.monotonic()
        self._is_answer_due = False
        self._file: int | None
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise DeviceFault(f"{path} must open as a USBTMC device; {error}") from error

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`; one call is one message."""
        try:
            os.write(self._ready(deadline), data)
        except TimeoutError as error:
            raise deadline.exceeded(f"{self.name} must take what is sent", "it does not") from error
        except OSError as error:
            raise DeviceFault(f"{self.name} must stay connected; {error}") from error
        self._is_answer_due = b"?" in data

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`; where nothing was asked, there is nothing to wait for."""
        if not self._is_answer_due:
            raise deadline.exceeded(f"{self.name} must receive", "nothing was asked")
        try:
            data = os.read(self._ready(deadline), _LONGEST_MESSAGE)
        except TimeoutError as error:
            self._is_answer_due = False
            raise deadline.exceeded(f"{self.name} must receive", "nothing came") from error
        except OSError as error:
            raise DeviceFault(f"{self.name} must stay connected; {error}") from error
        self._is_answer_due = not data.endswith(b"\n")
        self.arrived_s = time.monotonic()
        return data

    def close(self) -> None:
        """See `Port.close`."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _ready(self, deadline: Deadline) -> int:
        """The file, with what is left of the deadline as its timeout."""
        if self._file is None:
            raise DeviceFault(f"{self.name} must be open; it was closed")
        milliseconds = max(_SHORTEST_MS, round(1e3 * deadline.remaining_s))
        fcntl.ioctl(self._file, _SET_TIMEOUT, struct.pack("I", milliseconds))
        return self._file

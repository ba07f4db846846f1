"""Instruments that take messages (USBTMC, GPIB, VXI-11, HiSLIP) through pyvisa and pyvisa-py.

VISA carries messages, not a stream of bytes. Reading an answer that is not there is an error of the instrument, so this port reads only
after a question. VISA keeps no deadline either: pyvisa-py writes to USB for up to a second, regardless of the timeout, and after a missed
answer it takes up to 5 s a transfer to abort. So a separate thread owns the connection, and a call waits for it only until its deadline.
Late results are dropped, and the next call first waits until the thread is free.

On Linux, USB needs permission: a udev rule such as `SUBSYSTEM=="usb", ATTR{idVendor}=="1bfa", MODE="0666"`.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from drivers.deadline import Deadline
from drivers.errors import DeviceFault, DriverError, Refused

if TYPE_CHECKING:
    from pyvisa.resources import MessageBasedResource

_LOG = logging.getLogger(__name__)

_Result = TypeVar("_Result")

_OPEN_S = 10.0
_CLOSE_S = 1.0

_LONGEST_MESSAGE = 65536
"""Bytes requested at once: pyvisa-py takes a longer answer over USB for two."""

_TIMED_OUT = -1073807339
"""VI_ERROR_TMO of the VISA specification (VPP-4.3, annex A)."""


class VisaPort:
    """A `Port` to one instrument, with messages as its bytes."""

    def __init__(self, resource: str, *, timeout_s: float = _OPEN_S) -> None:
        """Open an instrument.

        Args:
            resource: VISA name, such as `USB0::0x1BFA::0x0498::0001::INSTR`, `GPIB0::6::INSTR` or `TCPIP::192.168.0.13::INSTR`.
            timeout_s: Time that opening may take.

        Raises:
            Refused: The resource is a serial line or a socket.
            DeviceFault: pyvisa is not installed, or the instrument is not there or not permitted.
        """
        if re.match("ASRL", resource, re.IGNORECASE) or re.search("::SOCKET$", resource, re.IGNORECASE):
            raise Refused(
                f"visa must name a USB, GPIB or VXI-11 instrument (serial lines and sockets have the keys serial and tcp); "
                f"received {resource}"
            )
        self.name = resource
        self.arrived_s = time.monotonic()
        self._is_closed = False
        self._n_due = 0
        """Answers that may be read: to the last question, and to earlier ones that were not answered in time."""
        self._n_missed = 0
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=f"visa {resource}")
        self._work: Future[Any] = Future()
        self._work.set_result(None)
        try:
            self._resource = self._call(partial(_open, resource), Deadline.after(timeout_s), "open")
        except DriverError as error:
            self._is_closed = True
            self._work.add_done_callback(_close_late)
            self._thread.shutdown(wait=False)
            raise DeviceFault(str(error)) from error

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`; one call is one message."""
        # If this call fails, nothing is read before the next question.
        n_asked = 1 if b"?" in data else 0
        self._n_due, self._n_missed = 0, self._n_missed + n_asked
        self._call(partial(_write, self._resource, data, deadline), deadline, "take what is sent")
        if n_asked:
            self._n_due, self._n_missed = self._n_missed, 0

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`; raises at once if nothing was asked or no time is left."""
        if not self._n_due or deadline.is_over:
            raise deadline.exceeded(
                f"{self.name} must receive", "nothing came" if self._n_due else "nothing was asked"
            )
        n_due, self._n_due = self._n_due, 0
        self._n_missed = n_due
        data, self.arrived_s = self._call(partial(_read, self._resource, deadline), deadline, "answer")
        is_whole = data.endswith(b"\n")  # IEEE 488.2, 8.5; a longer answer than requested continues
        self._n_due, self._n_missed = n_due - is_whole, 0
        return data

    def close(self) -> None:
        """See `Port.close`; if the thread is still busy, the connection is released later."""
        if self._is_closed:
            return
        self._is_closed = True
        closing = self._thread.submit(self._resource.close)
        self._thread.shutdown(wait=False)
        wait([closing], _CLOSE_S)
        if not closing.done():
            _LOG.warning("%s is still busy and will be closed later", self.name)
        elif error := closing.exception():
            _LOG.warning("%s did not close cleanly: %s", self.name, _reason(error))

    def _call(self, work: Callable[[], _Result], deadline: Deadline, what: str) -> _Result:
        """Run some work in the thread once it is free, and return the result."""
        if self._is_closed:
            raise DeviceFault(f"{self.name} must be open; it was closed")
        wait([self._work], deadline.remaining_s)
        if not self._work.done() or deadline.is_over:
            raise deadline.exceeded(f"{self.name} must {what}", "an earlier call is still running")
        self._work = future = self._thread.submit(work)
        wait([future], deadline.remaining_s)
        if not future.done():
            raise deadline.exceeded(f"{self.name} must {what}", "it does not")
        try:
            return future.result()
        except DriverError:
            raise
        except Exception as error:  # pyvisa-py passes on errors of USB, sockets and GPIB, and ValueError
            if getattr(error, "error_code", None) == _TIMED_OUT:
                raise deadline.exceeded(f"{self.name} must {what}", "it does not") from error
            raise DeviceFault(f"{self.name} must stay connected; {_reason(error)}") from error


def _open(name: str) -> MessageBasedResource:
    """Open the instrument; runs in the thread, as do all functions below."""
    try:
        import pyvisa
        import pyvisa_py  # noqa: F401  (pyvisa loads it by name, and its own message about a missing one is unclear)
        from pyvisa.resources import MessageBasedResource
    except ImportError as error:
        raise DeviceFault(
            f"{name} must be reached through pyvisa; it is not installed: pip install 'coilcal[visa]'"
        ) from error
    try:
        resource = pyvisa.ResourceManager("@py").open_resource(name)
    except Exception as error:  # of any kind, see above
        raise DeviceFault(f"{name} must be there, once, and be permitted; {_reason(error)}") from error
    if not isinstance(resource, MessageBasedResource):
        resource.close()
        raise DeviceFault(f"{name} must be an instrument that takes messages; it is of another kind")
    return resource


def _close_late(opening: Future[MessageBasedResource]) -> None:
    """Release an instrument that was opened after the deadline."""
    if opening.exception() is None:
        opening.result().close()


def _write(resource: MessageBasedResource, data: bytes, deadline: Deadline) -> None:
    resource.timeout = _milliseconds(deadline)
    resource.write_raw(data)


def _read(resource: MessageBasedResource, deadline: Deadline) -> tuple[bytes, float]:
    """A message, and when it arrived."""
    resource.timeout = _milliseconds(deadline)
    return resource.read_raw(_LONGEST_MESSAGE), time.monotonic()


def _milliseconds(deadline: Deadline) -> int:
    return max(1, round(1e3 * deadline.remaining_s))


def _reason(error: BaseException) -> str:
    """First line of an error's text; if several instruments match, pyvisa-py appends all their descriptors."""
    return " ".join(str(error).partition(":\n")[0].split()) or type(error).__name__

"""A USB bus for pyusb with test-and-measurement instruments (USBTMC 1.0, USB488), whose messages go to a pseudo-terminal.

Transfers of pyvisa-py are checked as a device would: headers, tags, sizes, alignment. Messages end with the line, both ways.
"""

from __future__ import annotations

import errno
import os
import select
import struct
import time
import tty
from collections import deque
from contextlib import contextmanager
from types import SimpleNamespace
from unittest import mock

import usb.backend
from usb.core import USBError, USBTimeoutError

from drivers.transport.visa import VisaPort

VENDOR, PRODUCT = 0x1BFA, 0x0498
OUT, IN = 0x01, 0x82
DEV_DEP_MSG_OUT, DEV_DEP_MSG_IN = 1, 2
INITIATE_ABORT_BULK_IN, CHECK_ABORT_BULK_IN_STATUS, GET_CAPABILITIES, REN_CONTROL = 3, 4, 7, 160
SUCCESS, NOT_IN_PROGRESS = 1, 0x81
END_OF_MESSAGE = 1
_STRINGS = {1: "Metrolab Technology SA", 2: "THM1176-MF"}


class FakeInstrument:
    """A USBTMC instrument; a pseudo-terminal, such as that of a simulator, answers its messages.

    Attributes:
        fault: `unplugged`, `stalled` (its bulk-in endpoint is halted), `garbled` (headers are noise), `full` (it takes nothing), or none.
        opens_after_s: Time that it takes to report its capabilities.
        hangs_at_abort: Whether it does not answer when a transfer is aborted.
        most_bytes: Most bytes in one transfer; longer answers take several.
        forgets: Whether it drops an unread answer when the next message comes, as IEEE 488.2 requires; otherwise answers queue up.
        log: Requests received over the control endpoint.
    """

    def __init__(self, line: str, packet_bytes: int = 64) -> None:
        self.serial_number, self.packet_bytes = line, packet_bytes
        self.fault, self.hangs_at_abort, self.forgets, self.most_bytes = "", False, True, 1 << 20
        self.opens_after_s = 0.0
        self.log: list[int] = []
        self._line = os.open(line, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._line)
        self._message, self._answer = b"", b""
        self._tag = 0
        self._request: tuple[int, int] | None = None
        self._packets: deque[bytes] = deque()

    @property
    def name(self) -> str:
        return f"USB0::0x{VENDOR:04X}::0x{PRODUCT:04X}::{self.serial_number}::INSTR"

    def open(self, **keywords) -> VisaPort:
        """Open a port to it, while it is the only instrument on the bus."""
        return open_on_bus([self], self.name, **keywords)

    @property
    def is_open(self) -> bool:
        return self._line >= 0

    def release(self) -> None:
        if self._line >= 0:
            os.close(self._line)
            self._line = -1

    def take(self, data: bytes) -> None:
        """Receive a transfer on the bulk-out endpoint."""
        message_id, tag, inverse, reserved, size, attributes = struct.unpack("<BBBBIB3x", data[:12])
        is_valid = tag not in (0, self._tag) and tag ^ inverse == 0xFF and reserved == 0
        if message_id == DEV_DEP_MSG_OUT:
            is_valid &= len(data) % 4 == 0 and len(data) - 12 - size in range(4) and not attributes & ~1
        else:
            is_valid &= message_id == DEV_DEP_MSG_IN and len(data) == 12 and size > 0
        if not is_valid:
            raise USBError("Pipe error", -9, errno.EPIPE)
        self._tag = tag
        if message_id == DEV_DEP_MSG_IN:
            self._request = tag, size
            return
        self._message += data[12 : 12 + size]
        if attributes & END_OF_MESSAGE:
            if self.forgets:
                self._forget()
            message, self._message = self._message, b""
            self._use_line(lambda: self._pass_on(message))

    def give(self, n_bytes: int, timeout_s: float) -> bytes:
        """Send a transfer on the bulk-in endpoint: whole packets up to a short one."""
        if not self._packets:
            self._begin_transfer(time.monotonic() + timeout_s)
        given = b""
        while self._packets and len(given) < n_bytes:
            packet = self._packets.popleft()
            given += packet
            if len(packet) < self.packet_bytes:
                break
        assert len(given) <= n_bytes, "the host must ask for whole packets"
        return given

    def control(self, request: int, value: int, n_bytes: int) -> bytes:
        """Answer a class request on the control endpoint."""
        self.log.append(request)
        if request == GET_CAPABILITIES:
            time.sleep(self.opens_after_s)
            return struct.pack("<BxHBB6xHBB8x", SUCCESS, 0x0100, 0, 0, 0x0100, 0b111, 0)[:n_bytes]
        if request == REN_CONTROL:
            return bytes([SUCCESS])
        if self.hangs_at_abort:
            raise TimeoutError
        if request == INITIATE_ABORT_BULK_IN:
            is_in_progress = self._request is not None and self._request[0] == value
            if is_in_progress:
                self._request = None
                self._packets = deque([b""])  # a short packet marks its end
            return bytes([SUCCESS if is_in_progress else NOT_IN_PROGRESS, value])
        if request == CHECK_ABORT_BULK_IN_STATUS:
            return struct.pack("<BBxxI", SUCCESS, 0, 0)
        raise USBError("Pipe error", -9, errno.EPIPE)

    def _begin_transfer(self, until_s: float) -> None:
        """Make the packets of a transfer, once an answer is there and was requested."""
        while b"\n" not in self._answer:
            self._answer += self._arrived(until_s)
        if self._request is None:
            raise self._waited_out(until_s)
        tag, asked_bytes = self._request
        end = self._answer.index(b"\n") + 1
        data = self._answer[: min(end, asked_bytes, self.most_bytes)]
        self._answer = self._answer[len(data) :]
        self._request = None
        header = struct.pack("<BBBxIB3x", DEV_DEP_MSG_IN, tag, ~tag & 0xFF, len(data), len(data) == end)
        if self.fault == "garbled":
            header = b"\xa5" * 12
        transfer = header + data + bytes(-len(data) % 4)
        starts = range(0, len(transfer) + 1, self.packet_bytes)  # an empty packet follows a full last one
        self._packets.extend(transfer[start : start + self.packet_bytes] for start in starts)

    def _arrived(self, until_s: float) -> bytes:
        while time.monotonic() < until_s and self.fault != "unplugged":
            if select.select([self._line], [], [], 0.01)[0]:
                return self._use_line(self._read)
        raise self._waited_out(until_s)

    def _waited_out(self, until_s: float) -> USBError:
        while time.monotonic() < until_s and self.fault != "unplugged":
            time.sleep(0.002)
        return lost() if self.fault == "unplugged" else late()

    def _pass_on(self, message: bytes) -> None:
        while message:
            if select.select([], [self._line], [], 1.0)[1]:  # a terminal holds a few thousand bytes
                message = message[os.write(self._line, message) :]

    def _forget(self) -> None:
        self._answer = b""
        while select.select([self._line], [], [], 0.0)[0]:
            self._use_line(self._read)

    def _read(self) -> bytes:
        data = os.read(self._line, 65536)
        if not data:
            raise OSError("end of file")
        return data

    def _use_line(self, use):
        try:
            return use()
        except OSError as error:  # the other side has gone
            self.fault = "unplugged"
            raise lost() from error


class FakeBus(usb.backend.IBackend):
    """A backend of pyusb in place of libusb, with some instruments."""

    def __init__(self, instruments) -> None:
        self.instruments = instruments

    def enumerate_devices(self):
        return iter([instrument for instrument in self.instruments if instrument.fault != "unplugged"])

    def get_device_descriptor(self, dev):
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=VENDOR, idProduct=PRODUCT, bcdDevice=0x0100, iManufacturer=1, iProduct=2,
            iSerialNumber=3, bNumConfigurations=1, address=1 + self.instruments.index(dev), bus=1, port_number=1,
            port_numbers=(1,), speed=2,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev, config):
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=32, bNumInterfaces=1, bConfigurationValue=1,
            iConfiguration=0, bmAttributes=0x80, bMaxPower=250, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev, intf, alt, config):
        if (intf, alt) != (0, 0):
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=2,
            bInterfaceClass=0xFE, bInterfaceSubClass=3, bInterfaceProtocol=1, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=(OUT, IN)[ep], bmAttributes=2,
            wMaxPacketSize=dev.packet_bytes, bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev):
        return dev

    def close_device(self, dev_handle):
        dev_handle.release()

    def set_configuration(self, dev_handle, config_value):
        pass

    def get_configuration(self, dev_handle):
        return 1

    def claim_interface(self, dev_handle, intf):
        pass

    def release_interface(self, dev_handle, intf):
        pass

    def is_kernel_driver_active(self, dev_handle, intf):
        return False

    def bulk_write(self, dev_handle, ep, intf, data, timeout):
        assert ep == OUT
        if dev_handle.fault == "unplugged":
            raise lost()
        if dev_handle.fault == "full":
            time.sleep(timeout / 1e3)
            raise late()
        dev_handle.take(data.tobytes())
        return len(data)

    def bulk_read(self, dev_handle, ep, intf, buff, timeout):
        assert ep == IN
        if dev_handle.fault == "unplugged":
            raise lost()
        if dev_handle.fault == "stalled":
            raise USBError("Pipe error", -9, errno.EPIPE)
        return fill(buff, dev_handle.give(len(buff), timeout / 1e3))

    def ctrl_transfer(self, dev_handle, bmRequestType, bRequest, wValue, wIndex, data, timeout):
        if dev_handle.fault == "unplugged":
            raise lost()
        if bmRequestType == 0x80 and bRequest == 6 and wValue >> 8 == 3:
            text = {**_STRINGS, 3: dev_handle.serial_number}.get(wValue & 0xFF)
            content = text.encode("utf-16-le") if text else struct.pack("<H", 0x0409)
            return fill(data, bytes([2 + len(content), 3]) + content)
        assert bmRequestType in (0xA1, 0xA2)
        try:
            return fill(data, dev_handle.control(bRequest, wValue, len(data)))
        except TimeoutError as error:
            time.sleep(timeout / 1e3)
            raise late() from error


@contextmanager
def bus_with(*instruments):
    """Put these instruments, and no others, on the bus for a block; ports opened in it stay on this bus."""
    bus = FakeBus(instruments)
    with mock.patch("usb.backend.libusb1.get_backend", return_value=bus):
        yield


def open_on_bus(instruments, name: str, **keywords) -> VisaPort:
    """Open a resource while these instruments, and no others, are on the bus."""
    with bus_with(*instruments):
        return VisaPort(name, **keywords)


def fill(buffer, data: bytes) -> int:
    n_bytes = min(len(buffer), len(data))
    buffer[:n_bytes] = type(buffer)("B", data[:n_bytes])
    return n_bytes


with bus_with():  # pyvisa-py gives up on USB for good if it finds no libusb when it is imported
    import pyvisa_py.usb  # noqa: F401


def lost() -> USBError:
    return USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def late() -> USBTimeoutError:
    return USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)

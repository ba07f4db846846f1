"""No packet of the fastest stream is lost over a pseudo-terminal."""

from __future__ import annotations

import os
import time
from functools import partial

import pytest

from drivers.hall.senis_3mh6 import SERIAL, Senis3MH6
from drivers.protocols import ReadingFlag
from drivers.simulated.hall import SimulatedSenis
from drivers.simulated.process import Simulator
from drivers.transport.pumped import PumpedPort
from drivers.transport.serial_port import SerialPort
from tests.drivers.fields import along_z

RATE_HZ = 15000
PAUSE_S = 10.0  # longest pause of a busy computer; only losses count here, not delays


class Tee:
    """Keeps what a port received."""

    def __init__(self, port):
        self.name, self.port, self.received = port.name, port, []

    @property
    def arrived_s(self):
        return self.port.arrived_s

    def send(self, data, deadline):
        self.port.send(data, deadline)

    def receive(self, deadline):
        self.received.append(self.port.receive(deadline))
        return self.received[-1]

    def close(self):
        self.port.close()


@pytest.mark.parametrize(
    "seconds", [2.0, pytest.param(float(os.environ.get("COILCAL_SENIS_S", "600")), marks=pytest.mark.slow)]
)
def test_no_packet_of_15000_a_second_is_lost(seconds, world):
    with Simulator.on_serial_line(partial(SimulatedSenis, world, along_z)) as simulator:
        port = Tee(PumpedPort(SerialPort(simulator.address, SERIAL)))
        with Senis3MH6(port, rate_Hz=RATE_HZ, range_number=1, full_scale_T=0.1) as sensor:
            sensor.read_new_T(timeout_s=5.0)
            port.received.clear()
            n_packets, next_count, tail = 0, None, b""
            end_s = time.monotonic() + seconds
            while time.monotonic() < end_s:
                readings = sensor.read_new_T(timeout_s=PAUSE_S)
                n_packets += len(readings)
                assert all(reading.flags == ReadingFlag.NONE for reading in readings)
                raw = tail + b"".join(port.received)
                port.received.clear()
                for start in range(0, len(raw) - 24, 25):
                    count = int.from_bytes(raw[start + 17 : start + 24], "big")
                    assert next_count in {None, count}
                    next_count = count + 1
                tail = raw[len(raw) - len(raw) % 25 :]
                time.sleep(0.01)
    assert n_packets == pytest.approx(RATE_HZ * seconds, rel=0.05)

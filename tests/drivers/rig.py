"""Simulated instruments behind real ports; each test starts its own processes."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import pytest

from drivers.hall.lakeshore_460 import SERIAL as SERIAL_460
from drivers.hall.lakeshore_460 import LakeShore460
from drivers.hall.lakeshore_f71 import SERIAL as SERIAL_F71
from drivers.hall.lakeshore_f71 import LakeShoreF71
from drivers.hall.metrolab_thm1176 import MetrolabTHM1176
from drivers.hall.senis_3mh6 import SERIAL as SERIAL_SENIS
from drivers.hall.senis_3mh6 import Senis3MH6
from drivers.simulated.hall import Simulated460, SimulatedF71, SimulatedSenis, SimulatedTHM1176
from drivers.simulated.process import Simulator
from drivers.simulated.supplies import SimulatedKorad, simulated_kepco, simulated_scpi_supply
from drivers.simulated.thermometers import Simulated224
from drivers.simulated.world import CoilCircuit, World
from drivers.supplies.korad_ka3005p import SERIAL as SERIAL_KORAD
from drivers.supplies.korad_ka3005p import KoradKA3005P
from drivers.supplies.ramped import RampedSource
from drivers.supplies.scpi import GENERIC, KEPCO_BOP, ScpiSupply
from drivers.supplies.supervised import SupervisedSource
from drivers.thermometers.lakeshore_224 import SERIAL as SERIAL_224
from drivers.thermometers.lakeshore_224 import LakeShore224
from drivers.transport.pumped import PumpedPort
from drivers.transport.serial_port import SerialPort, SerialSettings
from drivers.transport.tcp import TcpPort
from tests.drivers.fields import along_z
from tests.drivers.tcp_line import on_tcp
from tests.drivers.transport.fake_usb import FakeInstrument

KEPCO_SERIAL = SerialSettings(9600)
SLEW_A_PER_S = 20.0
UPDATE_460_S = 0.05
"""A fifth of the real one, so that the tests wait less."""


def tcp(address):
    host, _, port = address.rpartition(":")
    return TcpPort(host, int(port), timeout_s=2.0)


def source(port, dialect, lowest_A, slew_A_per_s):
    supply = ScpiSupply(
        port, dialect=dialect, lowest_A=lowest_A, highest_A=5.0, compliance_V=20.0, resolution_A=1e-3
    )
    return RampedSource(supply, slew_A_per_s=slew_A_per_s)


class Kind(NamedTuple):
    """A device and its simulator.

    Attributes:
        line: `serial` or `tcp`.
        instrument: What makes the simulator in its process, given the world.
        driver: Connects the driver to an address.
        maker: Beginning of what it says of itself.
    """

    line: str
    instrument: Callable
    driver: Callable
    maker: str


SENSORS = {
    "f71_serial": Kind(
        "serial",
        lambda world: partial(SimulatedF71, world, along_z),
        lambda address: LakeShoreF71(SerialPort(address, SERIAL_F71)),
        "LSCI",
    ),
    "f71_tcp": Kind(
        "tcp",
        lambda world: partial(SimulatedF71, world, along_z),
        lambda address: LakeShoreF71(tcp(address)),
        "LSCI",
    ),
    "460": Kind(
        "serial",
        lambda world: partial(Simulated460, world, along_z, UPDATE_460_S),
        lambda address: LakeShore460(SerialPort(address, SERIAL_460), range_T=0.03, update_s=UPDATE_460_S),
        "LSCI",
    ),
    "3mh6": Kind(
        "serial",
        lambda world: partial(SimulatedSenis, world, along_z),
        lambda address: Senis3MH6(
            PumpedPort(SerialPort(address, SERIAL_SENIS)), rate_Hz=1000, range_number=1, full_scale_T=0.1
        ),
        "Senis",
    ),
}
SENSORS["thm1176"] = Kind(
    "serial",
    lambda world: partial(SimulatedTHM1176, world, along_z),
    lambda address: MetrolabTHM1176(SerialPort(address, SERIAL_SENIS), range_T=0.1),
    "Metrolab",
)
SENSORS["thm1176_usb"] = SENSORS["thm1176"]._replace(
    driver=lambda address: MetrolabTHM1176(FakeInstrument(address).open(), range_T=0.1)
)
SOURCES = {
    "kepco": Kind(
        "serial",
        lambda world: partial(simulated_kepco, world, 0, 5.0),
        lambda address: source(SerialPort(address, KEPCO_SERIAL), KEPCO_BOP, -5.0, SLEW_A_PER_S),
        "KEPCO",
    ),
    "scpi_tcp": Kind(
        "tcp",
        lambda world: partial(simulated_scpi_supply, world, 0, 5.0),
        lambda address: source(tcp(address), GENERIC, 0.0, SLEW_A_PER_S),
        "COILCAL",
    ),
    "korad": Kind(
        "serial",
        lambda world: partial(SimulatedKorad, world, 0),
        lambda address: RampedSource(
            KoradKA3005P(SerialPort(address, SERIAL_KORAD), compliance_V=20.0), slew_A_per_s=SLEW_A_PER_S
        ),
        "KORAD",
    ),
}


def kepco_source(address, _interrupt):
    """Make a source; runs in the child process of a supervised source."""
    return source(SerialPort(address, KEPCO_SERIAL), KEPCO_BOP, -5.0, SLEW_A_PER_S)


SOURCES["kepco_supervised"] = Kind(
    "serial",
    lambda world: partial(simulated_kepco, world, 0, 5.0),
    lambda address: SupervisedSource(
        partial(kepco_source, address), "coil1", slew_A_per_s=SLEW_A_PER_S, longest_off_s=10.0
    ),
    "KEPCO",
)

MONITORS = {
    "224_serial": Kind(
        "serial",
        lambda world: partial(Simulated224, world, {"A": 0, "C1": None}),
        lambda address: LakeShore224(SerialPort(address, SERIAL_224), {"coil1": "A", "hall": "C1"}),
        "LSCI",
    ),
    "224_tcp": Kind(
        "tcp",
        lambda world: partial(Simulated224, world, {"A": 0, "C1": None}),
        lambda address: LakeShore224(tcp(address), {"coil1": "A", "hall": "C1"}),
        "LSCI",
    ),
}
DEVICES = {**SENSORS, **SOURCES, **MONITORS}

_addresses = itertools.count(1)


def free_host():
    """An address that no other test uses: the ports of a controller are fixed, and pytest-xdist runs several tests at once."""
    return f"127.{1 + os.getpid() % 254}.{1 + os.getpid() // 254 % 254}.{next(_addresses)}"


@pytest.fixture
def world():
    """A world with one coil of 2 ohm and no inductance."""
    return World([CoilCircuit(resistance_ohm=2.0, inductance_H=0.0)])


@pytest.fixture
def started(world):
    """Starts a simulator and connects its driver: `started(SENSORS["460"])` returns both."""
    simulators = []

    def start(kind):
        make = Simulator.on_serial_line if kind.line == "serial" else on_tcp
        simulator = make(kind.instrument(world))
        simulators.append(simulator)
        device = kind.driver(simulator.address)
        return simulator, device

    yield start
    for simulator in simulators:
        simulator.close()

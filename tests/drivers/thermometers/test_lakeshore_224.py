"""Transcripts of a Lake Shore 224."""

from __future__ import annotations

import math

import pytest

from drivers.errors import DeviceFault, Refused
from drivers.protocols import TemperatureMonitor, Thermometer
from drivers.thermometers.lakeshore_224 import LakeShore224
from tests.drivers.replay import conversation

COIL, HALL = b"KRDG? A;RDGST? A\n", b"KRDG? C1;RDGST? C1\n"


def monitor(*exchanges):
    return LakeShore224(conversation(*exchanges), {"coil1": "A", "hall": "C1"})


def test_each_input_is_read_in_kelvin_for_its_coil_or_sensor():
    device = monitor((COIL, b"+301.250;000\r\n"), (HALL, b"+295.100;000\r\n"), (COIL, b"+301.260;000\r\n"))
    assert isinstance(device, TemperatureMonitor)
    assert all(isinstance(thermometer, Thermometer) for thermometer in device.thermometers.values())
    coil, hall = device.thermometers["coil1"], device.thermometers["hall"]
    readings = [thermometer.read_temperature_K(timeout_s=1.0) for thermometer in (coil, hall, coil)]
    assert [reading.value for reading in readings] == [301.25, 295.1, 301.26]
    assert [reading.sequence for reading in readings] == [0, 0, 1]


@pytest.mark.parametrize(
    "answer", [b"+0.00000;128\r\n", b"+301.000;001\r\n", b"+1.40000;016\r\n", b"+475.0;32\r\n"]
)
def test_an_input_that_is_open_or_beyond_its_range_has_no_number(answer):
    assert math.isnan(monitor((COIL, answer)).thermometers["coil1"].read_temperature_K(timeout_s=1.0).value)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"+301.250\r\n", "must send kelvin;status"),
        (b"warm;000\r\n", "must be a number"),
        (b"+301.250;?\r\n", "must send kelvin;status"),
        (b"+301.250;\xff\r\n", "must be ASCII"),
    ],
)
def test_an_answer_that_makes_no_sense_is_a_fault(answer, message):
    with pytest.raises(DeviceFault, match=message):
        monitor((COIL, answer)).thermometers["coil1"].read_temperature_K(timeout_s=1.0)


def test_an_input_that_there_is_not_is_refused():
    with pytest.raises(
        Refused, match=r"thermometer.inputs.coil1 must be A, B, C1 to C5 or D1 to D5; received E"
    ):
        LakeShore224(conversation(), {"coil1": "E"})

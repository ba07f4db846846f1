"""Transcripts of a Metrolab THM1176."""

from __future__ import annotations

import pytest

from drivers.errors import DeviceFault, Refused
from drivers.hall.metrolab_thm1176 import MEASURE, MetrolabTHM1176, choose_range_T, encode_setup
from drivers.open import open_devices
from drivers.protocols import ReadingFlag
from tests.drivers.fields import PER_AMPERE_T, ROOM_T
from tests.drivers.replay import conversation
from tests.drivers.rig import SENSORS
from tests.drivers.transport.fake_usb import FakeInstrument, bus_with

SETUP = (encode_setup(0.1, 100).encode() + b"\n", b"0\n")
ASK = MEASURE.encode() + b"\n"
FIELDS = b"+0.00123 T;-0.00045 T;+0.01000 T;0x3B9ACA00;"
ERROR = b":SYST:ERR?\n"
NO_ERROR = (ERROR, b'0,"No error"\n')


def thm(*exchanges):
    return MetrolabTHM1176(conversation(*exchanges), range_T=0.05)


def test_it_is_set_up_once_and_measures_when_asked():
    sensor = thm(SETUP, (ASK, FIELDS + b"0\n"), (ASK, FIELDS.replace(b"A00", b"A01") + b"0\n"))
    first, second = sensor.read_field_T(timeout_s=1.0), sensor.read_new_T(timeout_s=1.0)[0]
    assert first.value == second.value == (0.00123, -0.00045, 0.01)
    assert first.device_time_s == pytest.approx(1.0)
    assert (first.flags, second.flags) == (ReadingFlag.NONE, ReadingFlag.NONE)


def test_a_measurement_that_comes_again_is_stale():
    sensor = thm(SETUP, (ASK, FIELDS + b"0\n"), (ASK, FIELDS + b"0\n"))
    flags = [sensor.read_field_T(timeout_s=1.0).flags for _ in range(2)]
    assert flags == [ReadingFlag.NONE, ReadingFlag.STALE]


@pytest.mark.parametrize("packet_bytes", [64, 512])
def test_it_measures_over_usb_through_pyvisa(packet_bytes, started, world):
    """Opened as by a rig file; a simulator in a child process answers behind a fake USB bus."""
    world.drive(0, 2.0)

    def opened(address):
        instrument = FakeInstrument(address, packet_bytes)
        settings = {"sensor": "metrolab_thm1176", "visa": instrument.name, "range_mT": 100}
        with bus_with(instrument):
            return open_devices({"hall": settings})

    _, devices = started(SENSORS["thm1176"]._replace(driver=opened))
    with devices:
        sensor = devices.sensors["hall"]
        assert sensor.identify(timeout_s=10.0).startswith("Metrolab")
        values_T = [sensor.read_field_T(timeout_s=10.0).value[2] for _ in range(3)]
        world.drive(0, 500.0)
        assert ReadingFlag.OVER_RANGE in sensor.read_field_T(timeout_s=10.0).flags
    assert values_T == pytest.approx([ROOM_T[2] + 2.0 * PER_AMPERE_T] * 3, abs=1e-8)


@pytest.mark.parametrize(
    ("error", "flag"),
    [
        (b'205,"Value over range"\n', ReadingFlag.OVER_RANGE),
        (b'204,"Acquisition overrun"\n', ReadingFlag.DROPPED),
        (b'206,"Timer overrun"\n', ReadingFlag.DROPPED),
    ],
)
def test_errors_of_a_reading_become_its_flags(error, flag):
    sensor = thm(SETUP, (ASK, FIELDS + b"4\n"), (ERROR, error), NO_ERROR)
    assert sensor.read_field_T(timeout_s=1.0).flags == flag


def test_errors_of_a_command_are_faults():
    with pytest.raises(DeviceFault, match="it says -221"):
        thm(SETUP, (ASK, FIELDS + b"4\n"), (ERROR, b'-221,"Settings conflict"\n')).read_field_T(timeout_s=1.0)


@pytest.mark.parametrize(
    "answer", [b"+1 T;+2 T;+3 T;0\n", b"+1;+2;+3;0x1;0\n", b"+1 T;+2 T;+3 T;noon;0\n", b"\xff\n"]
)
def test_an_answer_that_makes_no_sense_is_a_fault(answer):
    with pytest.raises(DeviceFault):
        thm(SETUP, (ASK, answer)).read_field_T(timeout_s=1.0)


def test_a_field_beyond_all_ranges_is_refused():
    assert choose_range_T(3.0) == 3.0
    with pytest.raises(Refused, match="at most 3.0; received 3.1"):
        choose_range_T(3.1)


def test_nothing_is_sent_that_resets_the_probe_or_writes_its_flash():
    assert not any(word in encode_setup(0.1, 1) + MEASURE for word in ("CAL", "DIAG", "MEAS:", "*RST"))

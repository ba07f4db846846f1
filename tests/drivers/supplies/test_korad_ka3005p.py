"""Transcripts of a Korad KA3005P."""

from __future__ import annotations

import time

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.supplies.korad_ka3005p import KoradKA3005P
from tests.drivers.replay import ScriptedPort, conversation
from tests.drivers.rig import SOURCES


def korad(*exchanges):
    return KoradKA3005P(conversation(*exchanges), compliance_V=12.0)


def soon():
    return Deadline.after(2.0)


def test_the_voltage_limit_is_set_and_read_back():
    korad((b"VSET1:12.00", None), (b"VSET1?", b"12.00")).prepare(soon())
    with pytest.raises(DeviceFault, match="must limit to 12 V; it says 5 V"):
        korad((b"VSET1:12.00", None), (b"VSET1?", b"05.00")).prepare(soon())


def test_the_stray_sixth_character_is_no_part_of_the_next_answer():
    supply = korad(
        (b"ISET1:1.500", None), (b"ISET1?", b"1.500K"), (b"IOUT1?", b"1.499"), (b"STATUS?", b"\x40")
    )
    supply.write_set_point(1.5, soon())
    assert supply.read_set_point_A(soon()) == 1.5
    assert supply.measure(soon()).current_A == 1.499


@pytest.mark.parametrize(
    ("status", "is_on", "is_regulating"),
    [(0x40, True, True), (0x41, True, False), (0x00, False, True), (0x01, False, True)],
)
def test_the_status_byte_tells_output_and_regulation(status, is_on, is_regulating):
    supply = korad((b"STATUS?", bytes([status])), (b"IOUT1?", b"0.500"), (b"STATUS?", bytes([status])))
    assert supply.is_output_on(soon()) is is_on
    assert supply.measure(soon()).is_regulating is is_regulating


@pytest.mark.parametrize(("is_on", "command"), [(True, b"OUT1"), (False, b"OUT0")])
def test_the_output_is_switched(is_on, command):
    korad((command, None)).switch_output(is_on, soon())


def test_commands_keep_the_distance_that_it_needs():
    supply = korad((b"OUT0", None), (b"OUT0", None), (b"OUT0", None))
    begin_s = time.monotonic()
    for _ in range(3):
        supply.switch_output(False, soon())
    assert time.monotonic() - begin_s >= 0.2


def test_a_late_set_point_is_not_taken_for_a_current():
    port = ScriptedPort([(0.7, b"3.000K")], [(0.9, b"KORADKA3005PV2.0")], [(0, b"1.499")], [(0, b"\x40")])
    late = KoradKA3005P(port, compliance_V=12.0)
    with pytest.raises(DeadlineExceeded):
        late.read_set_point_A(Deadline.after(0.3))
    assert late.measure(Deadline.after(10.0)).current_A == 1.499


def test_a_ramp_takes_the_time_that_its_rate_says(started):
    _, source = started(SOURCES["korad"])
    with source:
        source.slew_A_per_s = 0.8
        source.set_current_A(0.0, timeout_s=10.0)
        begin_s = time.monotonic()
        source.set_current_A(2.4, timeout_s=20.0)
        assert 3.0 <= time.monotonic() - begin_s < 4.8  # a step of 0.1 s made it 6


def test_a_short_answer_misses_its_deadline():
    with pytest.raises(DeadlineExceeded, match=r"must have 5 bytes within 0.1 s; received b'1.4'"):
        korad((b"ISET1?", b"1.4")).read_set_point_A(Deadline.after(0.1))


def test_an_answer_that_is_no_number_is_a_fault():
    with pytest.raises(DeviceFault, match="must be a number; received '1.4x9'"):
        korad((b"ISET1?", b"1.4x9")).read_set_point_A(soon())


def test_it_delivers_no_more_than_five_amperes():
    assert KoradKA3005P(conversation(), compliance_V=12.0, highest_A=9.0).highest_A == 5.0

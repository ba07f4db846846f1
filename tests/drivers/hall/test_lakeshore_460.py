"""Transcripts of a Lake Shore 460."""

from __future__ import annotations

import math

import pytest

from drivers.errors import DeviceFault, Refused
from drivers.hall.lakeshore_460 import SERIAL, LakeShore460, choose_range
from drivers.protocols import ReadingFlag
from tests.drivers.replay import conversation


def set_up(prefixes=("m", "m", "m"), range_answer=b"2"):
    exchanges = [(b"UNIT T\r\n", None)]
    for channel, prefix in zip("XYZ", prefixes, strict=True):
        exchanges += [(f"CHNL {channel}\r\n".encode(), None), (b"ACDC 0\r\n", None), (b"AUTO 0\r\n", None)]
        exchanges += [(b"RANGE 2\r\n", None), (b"RANGE?\r\n", range_answer + b"\r\n")]
        exchanges += [(b"FIELDM?\r\n", f"{prefix}\r\n".encode())]
    return exchanges


def read(answer, *, prefixes=("m", "m", "m")):
    port = conversation(*set_up(prefixes), (b"ALLF?\r\n", answer))
    return LakeShore460(port, range_T=0.02, update_s=0.0).read_field_T(timeout_s=5.0)


def test_fields_get_the_prefix_of_their_channel():
    reading = read(b"+12.500,-00.250,+1.0000,+00.00\r\n", prefixes=("m", "m", ""))
    assert reading.value == pytest.approx((0.0125, -0.00025, 1.0))
    assert reading.flags == ReadingFlag.NONE


def test_an_overloaded_axis_is_nan_and_flagged():
    reading = read(b"OL,-00.250, OL,+00.00\r\n")
    assert math.isnan(reading.value[0])
    assert reading.value[1] == pytest.approx(-0.00025)
    assert reading.flags == ReadingFlag.OVER_RANGE


@pytest.mark.parametrize("answer", [b"+1,+2,+3\r\n", b"+1,+2,x,+3\r\n", b"\xff\r\n"])
def test_an_answer_that_makes_no_sense_is_a_fault(answer):
    with pytest.raises(DeviceFault):
        read(answer)


def test_a_range_that_was_not_taken_is_a_fault():
    with pytest.raises(DeviceFault, match="must be in range 2 on channel X; it says '0'"):
        LakeShore460(conversation(*set_up(range_answer=b"0")[:6]), range_T=0.02).read_field_T(timeout_s=5.0)


def test_a_prefix_that_is_none_is_a_fault():
    with pytest.raises(DeviceFault, match="must send a prefix"):
        LakeShore460(conversation(*set_up(("G", "m", "m"))[:7]), range_T=0.02).read_field_T(timeout_s=5.0)


@pytest.mark.parametrize(
    ("highest_T", "number"), [(3.0, 0), (0.31, 0), (0.3, 1), (0.03, 2), (0.003, 3), (1e-5, 3)]
)
def test_the_most_sensitive_range_that_holds_the_field_is_chosen(highest_T, number):
    assert choose_range(highest_T) == number


def test_a_field_beyond_all_ranges_is_refused():
    with pytest.raises(Refused, match="at most 3.0; received 4.0"):
        choose_range(4.0)


def test_its_line_is_9600_baud_7_bits_odd_parity():
    assert (SERIAL.baud, SERIAL.data_bits, SERIAL.parity) == (9600, 7, "O")

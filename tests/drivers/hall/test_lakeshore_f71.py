"""Transcripts of a Lake Shore F71."""

from __future__ import annotations

import math

import pytest

from drivers.errors import DeviceFault
from drivers.hall.lakeshore_f71 import LakeShoreF71, decode_buffer, encode_setup, split_answers
from drivers.protocols import ReadingFlag, Thermometer
from tests.drivers.replay import conversation

OK = b'0,"No error"\r\n'
SETUP = (
    b":SENS:MODE DC;:UNIT:FIEL TESLA;:SENS:RANG:AUTO 0;:SENS:RANG 0.35;:SENS:AVER:COUN 1;:SYST:ERR:ALL?\n",
    OK,
)
NAME = (b"*IDN?\n", b"LSCI,F71,LSA1,1.6\r\n")
CLEAR = (b":FETC:BUFF:CLE;:SYST:ERR:ALL?\n", OK)
FETCH = b":FETC:BUFF:DC?;:STAT:OPER:COND?;:SYST:ERR:ALL?\n"


def point(milliseconds, z_T="0.3"):
    return f"2026-11-21T08:00:00.{milliseconds:03d}+00:00,0.374,0.1,-0.2,{z_T},0;"


def buffer(*points, condition=0):
    return f'"{"".join(points)}";{condition};'.encode() + OK


def f71(*exchanges):
    return LakeShoreF71(conversation(*exchanges), range_T=0.35)


def test_it_is_set_up_once_and_read_from_its_buffer():
    sensor = f71(
        SETUP, CLEAR, (FETCH, buffer()), (FETCH, buffer(point(10), point(20))), (FETCH, buffer(point(30)))
    )
    readings = sensor.read_new_T(timeout_s=1.0) + sensor.read_new_T(timeout_s=1.0)
    assert [reading.value for reading in readings] == [
        (0.1, -0.2, 0.3)
    ] * 3  # the magnitude, first in the line, is no component
    assert [reading.device_time_s for reading in readings] == pytest.approx(
        [1795248000.01, 1795248000.02, 1795248000.03]
    )
    assert [reading.flags for reading in readings] == [ReadingFlag.NONE] * 3


def test_a_fresh_field_is_the_second_point_after_the_call():
    sensor = f71(SETUP, CLEAR, CLEAR, (FETCH, buffer(point(20, "8"))), (FETCH, buffer(point(30, "7"))))
    reading = sensor.read_field_T(timeout_s=1.0)
    assert reading.value[2] == 7
    assert reading.flags == ReadingFlag.NONE


def test_points_missing_in_the_buffer_are_told():
    sensor = f71(SETUP, CLEAR, (FETCH, buffer(point(10), point(30), point(40))))
    flags = [reading.flags for reading in sensor.read_new_T(timeout_s=1.0)]
    assert flags == [ReadingFlag.NONE, ReadingFlag.DROPPED, ReadingFlag.NONE]


def test_a_point_that_comes_again_is_stale():
    sensor = f71(SETUP, CLEAR, (FETCH, buffer(point(10), point(10))))
    assert sensor.read_new_T(timeout_s=1.0)[1].flags == ReadingFlag.STALE


def test_overload_and_missing_numbers_are_over_range():
    sensor = f71(SETUP, CLEAR, (FETCH, buffer(point(10), condition=2)), (FETCH, buffer(point(20, "9.91E37"))))
    overload, missing = sensor.read_new_T(timeout_s=1.0) + sensor.read_new_T(timeout_s=1.0)
    assert overload.flags == missing.flags == ReadingFlag.OVER_RANGE
    assert math.isnan(missing.value[2])


def test_its_probe_is_a_thermometer():
    ask = b":FETC:TEMP?;:SYST:ERR:ALL?\n"
    sensor = f71(SETUP, CLEAR, (ask, b"24.850;" + OK), (ask, b"9.91E37;" + OK))
    assert isinstance(sensor, Thermometer)
    assert sensor.read_temperature_K(timeout_s=1.0).value == pytest.approx(298.0)
    assert math.isnan(sensor.read_temperature_K(timeout_s=1.0).value)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b'"";0;-113,"Undefined header"\r\n', "must accept .* it says -113"),
        (b'0,"No error"\r\n', "must give 2 answers"),
        (b"1" * 30_000 + b"\r\n", r"received b'1{80}' \(the first 80 of 30000 bytes\)"),
        (b'"2026-11-21T08:00:00,1,2,3;";0;0,"No error"\r\n', "must send time,magnitude,x,y,z,state"),
        (b'"yesterday,1,2,3,4,0;";0;0,"No error"\r\n', "must send time,magnitude,x,y,z,state"),
        (b'"2026-11-21T08:00:00,1,2,3,?,0;";0;0,"No error"\r\n', "must be a number"),
        (b'"\xff";0;0,"No error"\r\n', "must be ASCII"),
        (b'"";9.91E37;0,"No error"\r\n', "must send its status as a whole number; received '9.91E37'"),
    ],
)
def test_an_answer_that_makes_no_sense_is_a_fault(answer, message):
    with pytest.raises(DeviceFault, match=message):
        f71(SETUP, CLEAR, (FETCH, answer)).read_new_T(timeout_s=1.0)


def test_it_is_set_up_again_after_a_fault():
    sensor = f71(SETUP, CLEAR, (FETCH, b"?\r\n"), NAME, SETUP, CLEAR, (FETCH, buffer(point(10))))
    with pytest.raises(DeviceFault):
        sensor.read_new_T(timeout_s=1.0)
    assert len(sensor.read_new_T(timeout_s=1.0)) == 1


def test_without_a_range_the_instrument_chooses():
    assert encode_setup(None, 10) == ":SENS:MODE DC;:UNIT:FIEL TESLA;:SENS:RANG:AUTO 1;:SENS:AVER:COUN 10"


def test_entries_with_the_set_point_of_a_field_controller_are_read_too():
    (entry,) = decode_buffer("2026-11-21T08:00:00Z,0.374,0.1,-0.2,0.3,0.0,1")
    assert entry.field_T == (0.1, -0.2, 0.3)


def test_unquoted_answers_are_split_as_well():
    assert split_answers('1.5;-113,"a;b"') == ["1.5", '-113,"a;b"']

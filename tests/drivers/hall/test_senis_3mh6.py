"""Transcripts of a Senis 3MH6, and its stream in pieces, with garbage and with gaps."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceFault, Refused
from drivers.hall.senis_3mh6 import RATE_CODES, Packet, Senis3MH6, encode_packet, split_packets
from drivers.protocols import ReadingFlag, Thermometer
from drivers.transport.transcript import Chunk, ReplayedPort

START = [
    (">", b"S"),
    (">", b"C"),
    ("<", b"C\r"),
    (">", b"mr2"),
    ("<", b"mr2\r"),
    (">", b"K82"),
    ("<", b"K\x82"),
    (">", b"B"),
]

packets = st.builds(Packet, st.tuples(*[st.floats(-2000, 2000, width=32)] * 3), st.floats(0, 60, width=32))


def senis(*chunks, full_scale_T=0.1):
    port = ReplayedPort([Chunk(0.0, direction, data) for direction, data in chunks], "transcript")
    return Senis3MH6(port, rate_Hz=100, range_number=2, full_scale_T=full_scale_T)


def packet(x=1.0, y=-2.0, z=3.0):
    return encode_packet(Packet((x, y, z), 25.0))


def test_the_bytes_of_a_packet_are_those_of_the_public_drivers():
    assert packet().hex() == "42" + "3f800000" + "41c80000" + "c0000000" + "40400000" + "00" * 7 + "0d"


def test_it_is_set_up_and_streams():
    sensor = senis(*START, ("<", packet() + packet(z=4.0)[:10]), ("<", packet(z=4.0)[10:]), (">", b"S"))
    with sensor:
        readings = sensor.read_new_T(timeout_s=1.0)
    assert [reading.value for reading in readings] == [
        pytest.approx((1e-3, -2e-3, 3e-3)),
        pytest.approx((1e-3, -2e-3, 4e-3)),
    ]
    assert [reading.flags for reading in readings] == [ReadingFlag.NONE] * 2


def test_its_packets_carry_the_temperature():
    sensor = senis(*START, ("<", packet()), ("<", packet()))
    assert isinstance(sensor, Thermometer)
    assert sensor.read_temperature_K(timeout_s=1.0).value == pytest.approx(298.15)
    (reading,) = sensor.read_new_T(timeout_s=1.0)
    assert (reading.sequence, reading.flags) == (0, ReadingFlag.NONE)
    assert sensor.read_temperature_K(timeout_s=1.0).sequence == 1


def test_a_packet_cut_in_the_middle_is_dropped_and_told():
    sensor = senis(*START, ("<", packet()), ("<", packet()[:12] + packet(z=4.0) + packet(z=5.0)[:1]))
    first, second = sensor.read_new_T(timeout_s=1.0)
    assert (first.flags, second.flags) == (ReadingFlag.NONE, ReadingFlag.DROPPED)
    assert second.value[2] == pytest.approx(4e-3)


def test_a_field_beyond_the_range_is_flagged():
    sensor = senis(*START, ("<", packet(x=101.0)))
    assert sensor.read_new_T(timeout_s=1.0)[0].flags == ReadingFlag.OVER_RANGE


def test_a_rate_that_was_not_taken_is_a_fault():
    with pytest.raises(DeviceFault, match="must confirm rate code 82"):
        senis(*START[:6], ("<", b"K\x23")).read_new_T(timeout_s=1.0)


def test_settings_that_it_does_not_have_are_refused():
    with pytest.raises(Refused, match="rate_Hz must be one of 10, 30"):
        Senis3MH6(ReplayedPort([], "x"), rate_Hz=99, range_number=1, full_scale_T=0.1)
    with pytest.raises(Refused, match="range_number must be 1, 2, 3 or 4"):
        Senis3MH6(ReplayedPort([], "x"), rate_Hz=100, range_number=5, full_scale_T=0.1)


def test_it_identifies_itself_by_what_it_is_set_to():
    assert senis(*START[:-1]).identify(timeout_s=1.0) == "Senis, 3MH6, range 2, 100 Hz"


def test_all_rates_have_a_code_of_their_own():
    assert len(set(RATE_CODES.values())) == len(RATE_CODES) == 11


@given(st.lists(packets, max_size=5), st.lists(st.integers(1, 40), max_size=20))
def test_a_stream_is_split_alike_in_pieces_of_any_size(sent, sizes):
    stream = b"".join(map(encode_packet, sent))
    received, rest, start = [], b"", 0
    for size in [*sizes, len(stream)]:
        new, n_skipped, rest = split_packets(rest + stream[start : start + size])
        assert n_skipped == 0
        received += new
        start += size
    assert received == sent
    assert rest == b""


@given(st.binary(max_size=60), st.lists(packets, min_size=2, max_size=4))
def test_packets_are_found_again_after_garbage(garbage, sent):
    stream = garbage + b"".join(map(encode_packet, sent))
    received, n_skipped, rest = split_packets(stream)
    last = [*received, *split_packets(rest)[0]][-1]  # the last packet waits for the next byte to confirm it
    assert last == sent[-1]
    assert 25 * len(received) + n_skipped + len(rest) == len(stream)

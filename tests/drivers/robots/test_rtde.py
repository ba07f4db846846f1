"""RTDE packages survive encoding and decoding in pieces of any size, and anything else is a fault."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceFault
from drivers.robots.rtde import (
    Package,
    PackageType,
    Recipe,
    decode_data,
    decode_recipe,
    encode,
    encode_data,
    split,
)
from drivers.robots.safety_bits import why_not_running

RECIPE = Recipe(
    1, ("timestamp", "actual_q", "runtime_state", "flag"), ("DOUBLE", "VECTOR6D", "UINT32", "BOOL")
)
VALUES = [0.5, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), 2, True]

packages = st.lists(st.builds(Package, st.sampled_from(PackageType), st.binary(max_size=40)), max_size=6)


@given(packages, st.integers(1, 60))
def test_a_stream_is_split_alike_in_pieces_of_any_size(sent, size):
    stream = b"".join(map(encode, sent))
    received, rest = [], b""
    for start in range(0, len(stream), size):
        new, rest = split(rest + stream[start : start + size])
        received += new
    assert received == sent
    assert rest == b""


@pytest.mark.parametrize("stream", [b"\x00\x02U", b"\x00\x04?x"])
def test_what_is_no_package_is_a_fault(stream):
    with pytest.raises(DeviceFault, match="RTDE must send packages"):
        split(stream)


def test_data_survive_bytes_and_back():
    payload = encode_data(RECIPE, VALUES).payload
    assert list(decode_data(payload, RECIPE).values()) == VALUES
    assert payload.hex().startswith("01" + "3fe0000000000000" + "3ff0000000000000")


@pytest.mark.parametrize(
    "spoil", [lambda data: data[:-1], lambda data: b"\x02" + data[1:], lambda data: data + b"x"]
)
def test_data_of_another_recipe_are_a_fault(spoil):
    with pytest.raises(DeviceFault, match="RTDE must send recipe 1"):
        decode_data(spoil(encode_data(RECIPE, VALUES).payload), RECIPE)


def test_a_variable_that_the_controller_does_not_know_is_named():
    with pytest.raises(DeviceFault, match="it says wishes NOT_FOUND"):
        decode_recipe(b"\x01DOUBLE,NOT_FOUND", ["timestamp", "wishes"])


@pytest.mark.parametrize(
    ("bits", "runtime_state", "words"),
    [
        (1 << 2, 1, "protective stop"),
        (1 << 7 | 1 << 10, 1, "emergency stop"),
        (1 << 4, 1, "safeguard"),
        (1 << 9, 1, "fault"),
        (0, 2, "not in normal mode"),
        (1, 1, "program is not running"),
    ],
)
def test_the_operator_reads_why_the_arm_does_not_obey(bits, runtime_state, words):
    assert words in why_not_running({"safety_status_bits": bits, "runtime_state": runtime_state})


@pytest.mark.parametrize("bits", [1, 2])
def test_an_arm_in_normal_or_reduced_mode_obeys(bits):
    assert why_not_running({"safety_status_bits": bits, "runtime_state": 2}) is None

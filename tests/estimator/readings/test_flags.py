"""What digits say of readings: copies, stretches filled in and stuck bits are flagged, and what symmetry or few digits repeat is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from estimator.readings.digits import FEWEST_CODES, _stuck_bits, flags_of_digits, step_of
from estimator.readings.flags import Flag, Reason, told, without_flagged
from estimator.readings.observations import Observations
from tests.hidden.written_wrong import written

N = 60


def readings_of(field_T: np.ndarray, places_m: np.ndarray | None = None) -> Observations:
    n = len(field_T)
    places_m = np.arange(n)[:, None] * [1.0, 0.5, 0.2] if places_m is None else places_m
    motion = torch.cat((torch.as_tensor(places_m).double(), torch.zeros(n, 3, dtype=torch.float64)), 1)
    return Observations.of(torch.ones(n, 1).double(), {"arm": motion}, torch.from_numpy(field_T))


@pytest.fixture
def measured_T() -> np.ndarray:
    rng = np.random.default_rng(3)
    phase = np.arange(N)[:, None] * [0.11, 0.17, 0.05] + [0.0, 1.0, 2.0]
    return np.round(0.01 * np.sin(phase) + 3e-6 * rng.normal(size=(N, 3)), 7)


@pytest.mark.parametrize(("kind", "reason"), [("pasted", Reason.COPIED), ("interpolated", Reason.FILLED_IN)])
@pytest.mark.parametrize("seed", range(5))
def test_rows_that_were_copied_or_filled_in_are_flagged_and_no_others(measured_T, kind, reason, seed):
    assert flags_of_digits(readings_of(measured_T)) == []
    made = written(kind, measured_T, np.random.default_rng(seed))
    (flag,) = flags_of_digits(readings_of(made.field_T))
    assert (flag.reason, flag.component, flag.readings) == (reason, None, tuple(made.wrong.tolist()))


@pytest.mark.parametrize("value", [0, 1])
def test_a_bit_that_is_stuck_is_flagged_with_its_size(value):
    rng = np.random.default_rng(4)
    codes = rng.integers(-4000, 4000, size=(200, 3))
    codes[:, 1] = codes[:, 1] | 16 if value else codes[:, 1] & ~16
    readings = readings_of(2e-6 * codes)
    (flag,) = flags_of_digits(readings)
    assert (
        flag.clause(["hall"]) == f"y of hall has a bit of 32 µT that is always {value}, in all its readings"
    )
    assert without_flagged(readings, [flag]) is readings


@given(
    st.lists(st.integers(-(2**40), 2**40), max_size=80),
    st.integers(0, 2**41),
    st.integers(0, 2**41),
    st.sampled_from([1, 30, 2**20]),
)
def test_stuck_bits_are_those_that_never_change_below_30_codes(values, ones, zeros, width):
    """By the definition, which looks at all codes for each bit and takes seconds for a million of them."""
    codes = np.array([(value % width | ones) & ~zeros for value in values], dtype=np.float64)
    whole, expected, bit = codes.astype(np.int64), [], 0
    while len(np.unique(whole >> (bit + 1))) >= FEWEST_CODES:
        if len(value := np.unique(whole >> bit & 1)) == 1:
            expected.append((bit, int(value[0])))
        bit += 1
    assert list(_stuck_bits(codes)) == expected


def test_a_map_that_symmetry_repeats_is_left_alone():
    """A circle about the axis, walked in one sense, with fields that are alike to the last digit on both sides and from round to round."""
    angle = np.linspace(0.0, 4.0 * np.pi, 80, endpoint=False)
    places_m = np.stack((np.cos(angle), np.sin(angle), np.repeat([0.0, 1.0], 40)), 1)
    flat = np.round(np.stack((0.01 * np.cos(angle), 0.01 * np.sin(angle), 0.0 * angle), 1), 4)
    assert flags_of_digits(readings_of(flat, places_m)) == []


def test_a_second_round_of_the_same_places_is_no_copy(measured_T):
    places_m = np.tile(np.arange(N)[:, None] * [1.0, 0.5, 0.2], (2, 1))
    assert flags_of_digits(readings_of(np.tile(measured_T, (2, 1)), places_m)) == []


def test_a_straight_stretch_of_a_map_without_noise_is_left_alone():
    z = np.arange(N) * 1e-6
    field_T = np.stack((100 * z, 200 * z, -50 * z + 50 * z.max() * np.sin(3e4 * z)), 1)
    assert flags_of_digits(readings_of(np.round(field_T, 7))) == []


def test_sensors_are_judged_apart_in_the_order_of_time(measured_T):
    """Two sensors in turns, in a file that runs backwards."""
    made = written("pasted", measured_T, np.random.default_rng(1))
    both = readings_of(np.repeat(made.field_T, 2, axis=0))
    other = torch.arange(2 * N) % 2
    noise_T = torch.from_numpy(1e-5 * np.random.default_rng(2).normal(size=(2 * N, 3))).round(decimals=7)
    field_T = torch.where((other == 1)[:, None], both.field_sensor_T + noise_T, both.field_sensor_T)
    backwards = replace(both, sensor=other).with_field(field_T).rows(torch.arange(2 * N).flip(0)).alone
    (flag,) = flags_of_digits(backwards)
    assert flag.sensor == 0
    assert sorted(2 * N - 1 - row for row in flag.readings) == (2 * made.wrong).tolist()
    assert len(flag.stretches) == 1
    assert flag.where() == f"readings {flag.stretches[0][0] + 1} to {flag.stretches[0][1] + 1}"


def test_what_is_left_out_was_not_measured_and_all_else_stays(measured_T):
    readings = readings_of(measured_T)
    one = Flag.of(readings, Reason.HELD, "repeats the reading before", 2, [7])
    whole = Flag.of(readings, Reason.COPIED, "holds the fields of earlier readings", None, [9, 10])
    left = without_flagged(readings, [one, whole])
    expected = torch.ones(N, 3, dtype=torch.bool)
    expected[7, 2] = False
    expected[9:11] = False
    assert torch.equal(left.is_measured, expected)
    assert torch.equal(left.field_sensor_T[expected], readings.field_sensor_T[expected])
    assert told([one, whole], ["hall"]) == (
        "Readings are not as they were measured: z of hall repeats the reading before, in reading 8; hall holds the fields of earlier "
        "readings, in readings 10 to 11."
    )
    assert told([], ["hall"]) == ""


def test_steps_are_the_largest_decimal_of_which_all_values_are_multiples():
    assert step_of(np.array([0.0104, 0.0116, np.nan, -0.0080])) == pytest.approx(4e-4)
    assert step_of(np.array([0.1, np.pi])) == 0.0
    assert step_of(np.array([0.5, 0.5])) == 0.0


def held_T(field_T: np.ndarray, first: int, last: int) -> np.ndarray:
    """Fields of a sensor that repeats the reading before a stretch of rows, `last` excluded."""
    field_T = field_T.copy()
    field_T[first:last] = field_T[first - 1]
    return field_T


@pytest.mark.parametrize(("first", "last"), [(20, 26), (22, N), (1, 40), (50, 54)])
def test_a_sensor_that_stood_still_is_told_by_its_digits(measured_T, first, last):
    (flag,) = flags_of_digits(readings_of(held_T(measured_T, first, last)))
    assert (flag.reason, flag.component, flag.readings) == (Reason.HELD, None, tuple(range(first, last)))


def test_two_stretches_in_which_a_sensor_stood_still_are_told(measured_T):
    twice = held_T(held_T(measured_T, 10, 20), 35, 41)
    (flag,) = flags_of_digits(readings_of(twice))
    assert flag.readings == (*range(10, 20), *range(35, 41))
    assert flag.where() == "readings 11 to 20 and 36 to 41"


def test_a_sensor_of_one_component_that_stood_still_is_told(measured_T):
    measured_T[:, :2] = np.nan
    assert flags_of_digits(readings_of(measured_T)) == []
    (flag,) = flags_of_digits(readings_of(held_T(measured_T, 20, 32)))
    assert flag.readings == tuple(range(20, 32))


@pytest.mark.parametrize("step", [2, 5, 10])
def test_a_sensor_without_a_new_reading_in_each_nth_row_is_told(measured_T, step):
    measured_T[3::step] = measured_T[2::step][: len(measured_T[3::step])]
    (flag,) = flags_of_digits(readings_of(measured_T))
    assert (flag.reason, flag.readings) == (Reason.HELD, tuple(range(3, N, step)))
    measured_T[30:33] = measured_T[29] + 2e-3  # what is repeated besides is no such pattern
    flags = flags_of_digits(readings_of(measured_T))
    assert not {reading for flag in flags for reading in flag.readings} & set(range(3, 30))


def test_neighbours_that_symmetry_repeats_in_each_line_of_a_map_are_left_alone():
    """Components along and across the radius, four places on each side of the axis, in lines from left to right; no noise."""
    x, z = np.meshgrid(np.arange(-3.5, 4.0), np.arange(8.0))
    field_T = np.stack((0.01 / (1.0 + x**2 + z), 0.001 * z, 0.1 / (2.0 + x**2 + z**2)), 2).reshape(-1, 3)
    places_m = np.stack((x, 0.0 * x, z), 2).reshape(-1, 3)
    assert flags_of_digits(readings_of(field_T.round(7), places_m)) == []


def test_readings_that_are_repeated_at_one_place_are_right(measured_T):
    """Four readings a stop; the sensor stands still from the third reading of a stop on, and the fourth is right by chance."""
    stop = np.arange(N) // 4
    places_m = stop[:, None] * [1.0, 0.5, 0.2]
    dwelling_T = measured_T[4 * stop]
    assert flags_of_digits(readings_of(dwelling_T, places_m)) == []
    noise_T = np.random.default_rng(5).integers(-9, 9, (N, 3)) * 1e-7
    noisy_T = dwelling_T + noise_T
    (flag,) = flags_of_digits(readings_of(held_T(noisy_T, 19, 33), places_m))
    assert flag.readings == tuple(range(20, 33))


@pytest.mark.parametrize("digit_T", [1e-4, 1e-5])
def test_a_uniform_field_and_one_of_few_digits_are_left_alone(digit_T):
    """Along a long solenoid, from far outside to its middle, without noise."""
    z = np.linspace(-3.0, 0.5, N)
    along_T = 0.05 * (np.tanh((z + 1.0) / 0.2) + 1.0)
    field_T = np.stack((0.1 * along_T, 0.0 * z, along_T), 1)
    field_T = np.round(field_T / digit_T) * digit_T
    assert flags_of_digits(readings_of(field_T, np.stack((0 * z, 0 * z, z), 1))) == []


def test_a_map_of_which_symmetry_repeats_whole_circles_is_left_alone():
    """Components along and across the radius, alike all around each of three circles."""
    circle = np.arange(N) // 20
    angle = np.arange(N) * 2.0 * np.pi / 20
    places_m = np.stack((np.cos(angle), np.sin(angle), circle), 1)
    field_T = np.stack((0.01 + 0.003 * circle, 0.002 * circle, 0.05 + 0.01 * circle**2), 1).round(4)
    assert flags_of_digits(readings_of(field_T, places_m)) == []


SETTING_OUT = np.arange(N)[:, None] * [1e-3, 0.0, 0.0]


@pytest.mark.parametrize("rows", [(17,), (3, 44, 45)])
@pytest.mark.parametrize("value_T", [-0.26624, 0.9999, 99.99])
def test_a_number_that_stands_for_no_reading_is_flagged(measured_T, rows, value_T):
    field_T = np.round(measured_T / 1.3e-4) * 1.3e-4 if value_T == -0.26624 else measured_T
    field_T[list(rows), 2] = value_T
    readings = readings_of(field_T)
    (flag,) = [flag for flag in flags_of_digits(readings) if flag.reason == Reason.SENTINEL]
    assert (flag.component, flag.readings) == (2, rows)
    assert bool(without_flagged(readings, [flag]).field_sensor_T[list(rows), 2].isnan().all())


def test_a_field_that_meets_the_end_of_the_range_is_no_sentinel(measured_T):
    assert (
        flags_of_digits(readings_of(np.clip(measured_T, [-0.004096, -1.0, -1.0], [0.004096, 1.0, 1.0]))) == []
    )
    strong_T = measured_T.copy()
    strong_T[30] *= 20.0
    assert flags_of_digits(readings_of(strong_T)) == []


@pytest.mark.parametrize(("rows", "codes"), [((20,), 256), ((31, 32, 33), -65536), ((8, 40, 41), 65536)])
def test_codes_that_wrapped_around_or_lost_a_byte_are_flagged(rows, codes):
    slow = np.sin(np.arange(N)[:, None] * [0.11, 0.17, 0.05] + [0.0, 1.0, 2.0])
    field_T = 1e-6 * np.round(40.0 * slow + 500.0)
    assert flags_of_digits(readings_of(field_T, SETTING_OUT)) == []
    field_T[list(rows), 1] += 1e-6 * codes
    (flag,) = flags_of_digits(readings_of(field_T, SETTING_OUT))
    assert (flag.reason, flag.component, flag.readings) == (Reason.WRAPPED, 1, rows)


def test_a_current_that_is_switched_is_no_wrap():
    field_T = 1e-6 * np.round(np.random.default_rng(2).normal(size=(N, 3)) * [3, 4, 5] + [0.0, 20.0, -70.0])
    field_T[20:40] += 256e-6
    readings = readings_of(field_T, SETTING_OUT)
    switched = torch.ones(N, 1, dtype=torch.float64)
    switched[20:40] = 0.0
    assert flags_of_digits(replace(readings, current_A=switched)) == []


def test_a_sensor_that_froze_is_flagged_among_readings_for_validation_too(measured_T):
    measured_T[22:34] = measured_T[22]
    readings = readings_of(measured_T).with_validation(torch.arange(N) % 3 == 0)
    (flag,) = flags_of_digits(readings)
    assert (flag.reason, flag.readings) == (Reason.HELD, tuple(range(23, 34)))
    left = without_flagged(readings, [flag])
    assert not left.is_measured[23:34].any()
    assert bool(left.is_measured[:23].all())

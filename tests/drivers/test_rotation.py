"""Rotation vectors survive conversion to quaternions and back, and both vectors of a half turn give the same angle."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.rotation import angle_between_rad, inverse, product, quaternion, rotation_vector_rad

components = st.floats(-1.7, 1.7)  # the angle stays below half a turn
vectors = st.tuples(components, components, components)


@given(vectors)
def test_a_rotation_vector_survives_the_way_to_a_quaternion_and_back(vector_rad):
    assert rotation_vector_rad(quaternion(vector_rad)) == pytest.approx(vector_rad, abs=1e-9)


@given(vectors, vectors)
def test_a_rotation_and_its_inverse_leave_the_angle_between_two_others(first_rad, turn_rad):
    back = product(product(inverse(quaternion(turn_rad)), quaternion(turn_rad)), quaternion(first_rad))
    assert angle_between_rad(rotation_vector_rad(back), first_rad) == pytest.approx(0.0, abs=1e-6)


def test_half_a_circle_either_way_is_the_same_orientation():
    assert angle_between_rad((math.pi, 0.0, 0.0), (-math.pi, 0.0, 0.0)) == pytest.approx(0.0, abs=1e-9)


def test_two_quarter_turns_about_one_axis_are_a_half_turn():
    quarter = quaternion((0.0, math.pi / 2, 0.0))
    assert rotation_vector_rad(product(quarter, quarter)) == pytest.approx((0.0, math.pi, 0.0))

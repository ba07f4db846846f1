"""What is otherwise for a while: inside it is what stays from one instant on, before and after it is nothing."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.effects.laboratory import POINTS_M, assert_same_field, predicted_T, readings

TIME_S = 1e9 + 600.0 * np.arange(len(POINTS_M))
SPELL = {"since_h": 0.4, "until_h": 0.75}  # readings at 30 and 40 minutes
INSIDE = np.array([False, False, False, True, True, False, False])
SIZES = {
    "current_spell[coil]": {"step": 0.02},
    "current_sign_spell[coil]": {"sign": -1.0},
    "background_spell[room]": {"x_T": 1e-5, "z_T": 4e-5},
    "gain_spell[probe]": {"x": 0.02, "z": -0.01},
    "offset_spell[probe]": {"y_T": 3e-5},
}
STAYING = {
    "current_spell[coil]": "current_step[coil]",
    "current_sign_spell[coil]": "current_sign_since[coil]",
    "background_spell[room]": "background_step[room]",
    "offset_spell[probe]": "offset_step[probe]",
}


@pytest.mark.parametrize("label", SIZES)
def test_before_and_after_a_spell_nothing_is_otherwise(label):
    observations = readings(POINTS_M, (2.0, -3.0), time_s=TIME_S)
    as_described_T, reading_T = (
        predicted_T(observations, {}),
        predicted_T(observations, {label: SIZES[label] | SPELL}),
    )
    assert_same_field(reading_T[~INSIDE], as_described_T[~INSIDE])
    assert bool((reading_T[INSIDE] != as_described_T[INSIDE]).any(axis=-1).all())


@pytest.mark.parametrize("label", STAYING)
def test_a_spell_is_what_stays_less_what_stays_from_its_end_on(label):
    """Where it does not end within the session it is the cause that stays."""
    observations = readings(POINTS_M, (2.0, -3.0), time_s=TIME_S)
    staying_T = predicted_T(observations, {STAYING[label]: SIZES[label] | {"since_h": SPELL["since_h"]}})
    endless_T = predicted_T(
        observations, {label: SIZES[label] | {"since_h": SPELL["since_h"], "until_h": 99.0}}
    )
    assert_same_field(endless_T, staying_T)
    spell_T = predicted_T(observations, {label: SIZES[label] | SPELL})
    assert_same_field(spell_T[INSIDE], staying_T[INSIDE])


def test_gains_of_a_spell_multiply_the_components():
    observations = readings(POINTS_M, (2.0, -3.0), time_s=TIME_S)
    as_described_T = predicted_T(observations, {})
    reading_T = predicted_T(observations, {"gain_spell[probe]": SIZES["gain_spell[probe]"] | SPELL})
    assert_same_field(reading_T[INSIDE], (as_described_T * [1.02, 1.0, 0.99])[INSIDE])


def test_a_mover_that_stands_elsewhere_for_a_while_reads_the_field_there_meanwhile():
    shift_m = np.array([4e-4, -3e-4, 6e-4])
    given = dict(zip(("x_m", "y_m", "z_m"), shift_m, strict=True)) | SPELL
    reading_T = predicted_T(readings(POINTS_M, (2.0, -3.0), time_s=TIME_S), {"mover_spell[mapper]": given})
    really_m = POINTS_M + np.where(INSIDE[:, None], shift_m, 0.0)
    assert_same_field(reading_T, predicted_T(readings(really_m, (2.0, -3.0), time_s=TIME_S)))

"""A map of three days, before each of which something was set up anew: it is named with its size on each day."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator import Session, simulate
from estimator.diagnosis.diagnose import diagnose
from estimator.model.simulate import perfect_readings
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from tests.estimator.diagnosis.test_stated import MAPPER, assert_named, plan_of

pytestmark = pytest.mark.whole

RIG = rig_from_text(MAPPER)
DAY_S = 86400.0
DAY = np.arange(80) * 3 // 80
SHIFT_M = 1e-4 * np.array([[4.0, -1.0, 0.0], [-3.0, 2.0, 3.0], [0.0, -4.0, -2.0]])
TURN_RAD = 1e-3 * np.array([[0.0, 6.0, -3.0], [4.0, -5.0, 2.0], [-6.0, 0.0, 5.0]])
ZERO_T = 1e-5 * np.array([[4.0, 0.0, -2.0], [-3.0, 5.0, 0.0], [0.0, -3.0, 5.0]])
GAIN = np.array([0.006, -0.009, 0.004])


def on_three_days() -> Observations:
    """The plan with its noise, a third of it on each day."""
    plain = simulate(RIG, plan_of(RIG), {}, 3)
    return replace(plain, time_s=plain.time_s + DAY_S * torch.from_numpy(DAY))


def with_a_place_of_its_own() -> Observations:
    """The mapper stood elsewhere than it said on each day: the field there, and the noise of where it said."""
    said = on_three_days()
    at_m, turned = said.motion["arm"][:, :3].numpy(), Rotation.from_rotvec(said.motion["arm"][:, 3:].numpy())
    turn = Rotation.from_rotvec(TURN_RAD[DAY])
    real = np.concatenate((SHIFT_M[DAY] + turn.apply(at_m), (turn * turned).as_rotvec()), axis=1)
    there = replace(said, motion={"arm": torch.from_numpy(real)})
    return said.with_field(said.field_sensor_T + perfect_readings(RIG, there) - perfect_readings(RIG, said))


def with_a_zero_of_its_own() -> Observations:
    plain = on_three_days()
    return plain.with_field(plain.field_sensor_T + torch.from_numpy(ZERO_T[DAY]))


def with_a_gain_of_its_own() -> Observations:
    plain = on_three_days()
    return plain.with_field(plain.field_sensor_T * (1.0 + torch.from_numpy(GAIN[DAY, None])))


def sizes(suffixes: tuple[str, ...], by_day: np.ndarray) -> dict[str, float]:
    return {
        f"segment{day}_{suffix}": float(value)
        for day, row in enumerate(by_day)
        for suffix, value in zip(suffixes, row, strict=True)
    }


PLACES = sizes(("x_m", "y_m", "z_m"), SHIFT_M) | sizes(("rx_rad", "ry_rad", "rz_rad"), TURN_RAD)


@pytest.mark.parametrize(
    ("observations", "cause", "truth", "twins"),
    [
        pytest.param(with_a_place_of_its_own, Cause("segment_misplaced", "arm"), PLACES, set(), id="place"),
        pytest.param(
            with_a_zero_of_its_own,
            Cause("segment_zero", "hall"),
            sizes(("x_T", "y_T", "z_T"), ZERO_T),
            set(),
            id="zero",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            with_a_gain_of_its_own,
            Cause("segment_gain", "hall"),
            sizes(("gain",), GAIN[:, None]),
            {"coil_heating[coil]"},  # warmer on one day: halves of the readings do not refute it
            id="gain",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_was_set_up_anew_each_day_is_named_with_its_sizes(observations, cause, truth, twins):
    diagnosis = diagnose(Session(RIG, observations(), "by hand"), seed=1)
    assert_named(diagnosis, cause, twins)
    quantities = diagnosis.quantities(cause)
    assert set(quantities) == set(truth)
    for key, size in truth.items():
        assert abs(quantities[key].median - size) < 4.0 * quantities[key].sd, key
    again = rig_from_text(rig_text(diagnosis.extended_rig))
    assert again.effects == (cause,)

"""The scatter of readings at one place is the noise of the sensor, whatever field is there."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.scatter import scatter_T
from estimator.rig_files.read import rig_from_text
from tests.estimator.conftest import RIG

CURRENTS = ({"coil1": -3.0}, {"coil1": 0.0}, {"coil1": 1.5}, {"coil1": 3.0})


def test_it_is_the_noise_and_no_field_of_coil_or_room_adds_to_it(small_plan):
    rig = rig_from_text(RIG + "effects:\n  background_field[room]: {x_T: 1.0e-3, y_T: 0, z_T: 0}\n")
    observations = simulate(rig, replace(small_plan, currents_A=CURRENTS), {}, seed=1)
    (noise_T,) = scatter_T(observations, 1)
    n = 3 * 2 * len(observations) // 4
    assert noise_T == pytest.approx(5e-6, rel=4.0 / (2.0 * n) ** 0.5)


def test_repeats_at_one_current_count(small_plan):
    observations = simulate(rig_from_text(RIG), replace(small_plan, repeats=3), {}, seed=2)
    (noise_T,) = scatter_T(observations, 1)
    assert noise_T == pytest.approx(5e-6, rel=0.25)


def test_places_that_are_read_once_or_twice_tell_nothing(small_plan):
    once = simulate(rig_from_text(RIG), small_plan, {}, seed=3)
    assert scatter_T(once, 1) == [None]
    twice = simulate(rig_from_text(RIG), replace(small_plan, currents_A=CURRENTS[1:3]), {}, seed=3)
    assert scatter_T(twice, 1) == [None]


def test_each_sensor_has_its_own_and_missing_components_are_left_out(small_plan):
    observations = simulate(
        rig_from_text(RIG), replace(small_plan, currents_A=CURRENTS, repeats=2), {}, seed=4
    )
    n = len(observations)
    field_T = torch.cat((observations.field_sensor_T, 10.0 * observations.field_sensor_T))
    field_T[::5, 0] = float("nan")
    both = replace(
        observations.rows(torch.arange(n).repeat(2)),
        field_sensor_T=field_T,
        sensor=torch.cat((observations.sensor, observations.sensor + 1)),
    )
    quiet_T, loud_T = scatter_T(both, 2)
    assert quiet_T == pytest.approx(5e-6, rel=0.3)
    assert loud_T == pytest.approx(50e-6, rel=0.3)


def test_a_component_that_was_read_nowhere_tells_nothing(small_plan):
    observations = simulate(rig_from_text(RIG), replace(small_plan, repeats=3), {}, seed=5)
    field_T = observations.field_sensor_T.clone()
    field_T[:, 1] = float("nan")
    (noise_T,) = scatter_T(replace(observations, field_sensor_T=field_T), 1)
    assert noise_T == pytest.approx(5e-6, rel=0.3)


def test_readings_that_were_written_beside_a_wrong_place_do_not_count(small_plan):
    observations = simulate(rig_from_text(RIG), replace(small_plan, repeats=3), {}, seed=6)
    field_T = observations.field_sensor_T.clone()
    field_T[::40] = field_T[::40].flip(0)
    (noise_T,) = scatter_T(replace(observations, field_sensor_T=field_T), 1)
    assert noise_T == pytest.approx(5e-6, rel=0.25)


def test_all_readings_are_looked_at_once_and_not_for_each_place(small_plan, monkeypatch):
    observations = simulate(rig_from_text(RIG), replace(small_plan, repeats=2), {}, seed=4)
    looks = []
    is_measured = Observations.is_measured.fget
    assert is_measured is not None
    monkeypatch.setattr(Observations, "is_measured", property(lambda o: looks.append(o) or is_measured(o)))
    scatter_T(observations, 1)
    assert len(looks) == 1

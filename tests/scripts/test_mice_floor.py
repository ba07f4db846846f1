"""What nothing could have taken from a map, on made-up rests whose noise and structure are known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from scripts.studies import mice_floor
from scripts.studies.mice_floor import Rest, best_smooth, repeats_T2, rms_mT, weighed_T

NOISE_T = (30e-6, 60e-6)  # of two probes, for each component


def rest(structure_T: float, seed: int) -> Rest:
    """Two probes at 25 places and 9 angles, twice each; the first half of the angles is unseen at a third of the places."""
    rng = np.random.default_rng(seed)
    z, angle, _repeat, sensor = (
        each.ravel() for each in np.meshgrid(np.arange(25) * 0.05, np.arange(9) * 0.7, [0, 1], [0, 1])
    )
    wave = np.sin(z / 0.3) * np.cos(angle)
    rest_T = structure_T * wave[:, None] + np.take(NOISE_T, sensor.astype(int))[:, None] * rng.normal(
        size=(len(z), 3)
    )
    is_unseen = (np.round(z / 0.05) % 3 == 0) & (angle < 3.0)
    return Rest(rest_T, np.ones((len(z), 3)), z, angle, sensor.astype(int), is_unseen)


def scatter_T(left: Rest) -> float:
    return weighed_T(left, repeats_T2("made up", left))


def test_scatter_is_that_of_repeats_and_not_of_structure():
    expected_T = np.sqrt(3.0 * np.mean(np.square(NOISE_T)))
    for structure_T in (0.0, 500e-6):
        assert scatter_T(rest(structure_T, 1)) == pytest.approx(expected_T, rel=0.05)


def test_probes_count_as_often_as_they_are_unseen():
    plain = rest(0.0, 2)
    one = Rest(
        *(getattr(plain, name) for name in list(plain.__dict__)[:-1]), plain.is_unseen & (plain.sensor == 1)
    )
    assert scatter_T(one) == pytest.approx(np.sqrt(3.0) * NOISE_T[1], rel=0.05)


def test_a_map_without_repeats_has_the_scatter_of_full_maps_where_their_field_is_as_weak(monkeypatch):
    full = rest(0.0, 4)
    strong = full.along_m > 0.5
    rng = np.random.default_rng(5)
    field_T = full.rest_T + np.where(
        strong[:, None], [2.0, 0.0, 0.0] + 1e-3 * rng.normal(size=(len(strong), 3)), 0.0
    )
    motion = np.zeros((len(strong), 6))
    motion[:, 2], motion[:, 5] = full.along_m, full.angle_rad
    readings = SimpleNamespace(
        field_sensor_T=torch.from_numpy(field_T),
        motion={"mapper": torch.from_numpy(motion)},
        sensor=torch.from_numpy(full.sensor),
    )
    monkeypatch.setattr(mice_floor, "readings_of", lambda name: readings)
    once = np.unique(np.stack((full.along_m, full.angle_rad, full.sensor)), axis=1, return_index=True)[1]
    each = {name: value[once] for name, value in full.__dict__.items()}
    expected_T = np.sqrt(3.0) * np.array(NOISE_T)
    assert np.sqrt(repeats_T2("made up", Rest(**each))) == pytest.approx(expected_T, rel=0.1)


def test_smooth_structure_is_taken_down_to_the_scatter(monkeypatch):
    monkeypatch.setattr(mice_floor, "SETTINGS", ((0.2, 1.5, 3.0, False), (0.05, 0.3, 0.3, False)))
    left = rest(200e-6, 3)
    value, words = best_smooth(left)
    assert rms_mT(left.rest_T[left.is_unseen]) > 0.15
    assert value == pytest.approx(1e3 * scatter_T(left), rel=0.1)
    assert words.startswith("0.2 m along the rail")

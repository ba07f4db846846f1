"""Small sources right beside a box of readings: found where they are, none where there is none, and from calibration readings alone."""

from __future__ import annotations

from dataclasses import replace

import magpylib
import numpy as np
import pytest
import torch

from estimator import SamplerSettings, calibrate
from estimator.calibration.multipole_places import with_multipoles
from estimator.errors import InvalidInput
from estimator.readings.observations import Observations
from estimator.rig.rig import EquivalentSourceCoil, Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from estimator.store.session import Session
from tests.estimator.calibration.test_equivalent_sources import TEXT, in_box
from tests.estimator.calibration.test_unwound import hidden_T, session_at

pytestmark = pytest.mark.whole

PLACE_M = (0.012, -0.004, 0.026)  # 6 mm above the box, a fifth of the margin
SETTINGS = SamplerSettings(target_ess=400.0)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(TEXT)


def small_T(places_m: np.ndarray) -> torch.Tensor:
    """Field of a small dipole, of some mT where the box comes nearest."""
    field_T = magpylib.misc.Dipole(position=PLACE_M, moment=(1e-3, 2e-3, -2e-3)).getB(places_m)
    return torch.from_numpy(field_T)


@pytest.fixture(scope="module")
def places_m() -> np.ndarray:
    return in_box(250, 3)


@pytest.fixture(scope="module")
def plain(rig: Rig, places_m: np.ndarray) -> Session:
    return session_at(rig, places_m)


@pytest.fixture(scope="module")
def beside(plain: Session, places_m: np.ndarray) -> Session:
    observations = plain.observations
    shown_T = observations.field_sensor_T + observations.current_A[:, :1] * small_T(places_m)
    return replace(plain, observations=replace(observations, field_sensor_T=shown_T))


def places_of(rig: Rig, observations: Observations) -> np.ndarray:
    coil = with_multipoles(rig, observations)[0].unwound[0]
    assert isinstance(coil, EquivalentSourceCoil)
    return np.array(coil.multipoles_m)


def test_a_dipole_is_found_where_it_is_and_the_field_with_it(rig: Rig, beside: Session) -> None:
    better, found = with_multipoles(rig, beside.observations)
    assert len(found.places_m) == 1
    assert found.gains[0] > 100.0
    np.testing.assert_allclose(found.places_m[0], PLACE_M, atol=1.5e-3)
    assert rig_from_text(rig_text(better)) == better
    unseen_m = in_box(100, 99)
    true_T = torch.from_numpy(hidden_T(unseen_m)) + small_T(unseen_m)
    errors = []
    for one in (rig, better):
        calibration = calibrate(Session(one, beside.observations, ""), one, seed=1, settings=SETTINGS)
        points_m = torch.from_numpy(unseen_m)
        errors.append(float((calibration.field(points_m, {"c1": 1.0}) - true_T).norm() / true_T.norm()))
    lower, upper = calibration.field_interval(points_m, {"c1": 1.0})
    assert 0.8 < float(((lower <= true_T) & (true_T <= upper)).double().mean()) <= 1.0
    assert errors[1] < 0.3 * errors[0]


def test_none_is_taken_where_none_is(rig: Rig, plain: Session) -> None:
    same, found = with_multipoles(rig, plain.observations)
    assert found.places_m == ()
    assert same == rig
    assert same.hash == rig.hash


def test_readings_for_validation_are_not_looked_at(rig: Rig, beside: Session) -> None:
    n = len(beside.observations)
    is_held = torch.arange(n) % 5 == 0
    held = beside.observations.with_validation(is_held)
    spoilt_T = held.field_sensor_T + is_held[:, None] * 1.0
    np.testing.assert_array_equal(
        places_of(rig, held), places_of(rig, replace(held, field_sensor_T=spoilt_T))
    )


def test_a_rig_with_more_that_is_free_is_refused(beside: Session) -> None:
    text = TEXT.replace(
        "spacing_mm: 18", "spacing_mm: 18\n    world_from_coil: {x_mm: {prior: {normal: {mean: 0, sd: 1}}}}"
    )
    with pytest.raises(
        InvalidInput, match="must leave nothing free but amplitudes and the noise of one sensor"
    ):
        with_multipoles(rig_from_text(text), beside.observations)

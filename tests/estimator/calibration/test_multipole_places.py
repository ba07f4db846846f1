"""Small sources right beside a box of readings: found where readings are beside them, none elsewhere, from calibration readings alone."""

from __future__ import annotations

import json
from dataclasses import replace

import magpylib
import numpy as np
import pytest
import torch
from click.testing import CliRunner

from estimator import SamplerSettings, calibrate
from estimator.calibration import place_search
from estimator.calibration.multipole_places import with_multipoles
from estimator.calibration.place_search import Found
from estimator.cli.main import main
from estimator.errors import InvalidInput
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.write import rig_text
from estimator.store.session import Session
from tests.estimator.calibration.test_equivalent_sources import TEXT as FINE_TEXT
from tests.estimator.calibration.test_unwound import hidden_T, session_at

pytestmark = pytest.mark.whole

HALF_M = 0.02
TEXT = FINE_TEXT.replace("half_x_mm: 30", "half_x_mm: 20").replace("spacing_mm: 18", "spacing_mm: 25")
PLACE_M = (0.012, -0.004, 0.026)  # 6 mm above the box, a fifth of the margin
SETTINGS = SamplerSettings(target_ess=400.0)


def in_box(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-HALF_M, HALF_M, (n, 3))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(TEXT)


def small_T(places_m: np.ndarray) -> torch.Tensor:
    """Field of a small dipole, of some mT where the box comes nearest."""
    field_T = magpylib.misc.Dipole(position=PLACE_M, moment=(2e-3, 4e-3, -4e-3)).getB(places_m)
    return torch.from_numpy(field_T)


@pytest.fixture(scope="module")
def places_m() -> np.ndarray:
    beside_it = np.array([[0.012, -0.004, 0.019]])
    return np.concatenate((in_box(249, 3), beside_it))


@pytest.fixture(scope="module")
def plain(rig: Rig, places_m: np.ndarray) -> Session:
    return session_at(rig, places_m)


@pytest.fixture(scope="module")
def observations(plain: Session, places_m: np.ndarray) -> Observations:
    """Readings beside the dipole, a fifth of them for validation."""
    own = plain.observations
    shown_T = own.field_sensor_T + own.current_A[:, :1] * small_T(places_m)
    return replace(own, field_sensor_T=shown_T).with_validation(torch.arange(len(own)) % 5 == 0)


@pytest.fixture(scope="module")
def better(rig: Rig, observations: Observations) -> tuple[Rig, Found]:
    return with_multipoles(rig, observations)


def test_a_dipole_is_found_where_it_is_and_the_field_with_it(rig, observations, better):
    with_it, found = better
    assert len(found.places_m) == 1
    assert found.gains[0] > 100.0
    np.testing.assert_allclose(found.places_m[0], PLACE_M, atol=1.5e-3)
    assert rig_from_text(rig_text(with_it)) == with_it
    unseen_m = in_box(100, 99)
    true_T = torch.from_numpy(hidden_T(unseen_m)) + small_T(unseen_m)
    errors = []
    for one in (rig, with_it):
        calibration = calibrate(Session(one, observations, ""), one, seed=1, settings=SETTINGS)
        points_m = torch.from_numpy(unseen_m)
        errors.append(float((calibration.field(points_m, {"c1": 1.0}) - true_T).norm() / true_T.norm()))
    lower, upper = calibration.field_interval(points_m, {"c1": 1.0})
    assert 0.8 < float(((lower <= true_T) & (true_T <= upper)).double().mean()) <= 1.0
    assert errors[1] < 0.3 * errors[0]


def test_the_command_writes_the_rig_that_was_found(rig, observations, better, tmp_path):
    Session(rig, observations, "").save(tmp_path / "session.zarr")
    call = ["multipoles", f"{tmp_path}/session.zarr", "--out", f"{tmp_path}/rig.yaml"]
    result = CliRunner().invoke(main, [*call, "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.output)
    with_it, found = better
    assert load_rig(tmp_path / "rig.yaml").unwound == with_it.unwound
    np.testing.assert_allclose(told["places_mm"], 1e3 * np.array(found.places_m), atol=1e-4)
    assert told["log_evidence_gains"] == pytest.approx(list(found.gains))
    again = CliRunner().invoke(main, call)
    assert again.exit_code == 2
    assert "--overwrite" in again.output


def test_two_dipoles_are_two_multipoles_where_they_are(rig, monkeypatch):
    """The first begins as a mean of both; kept there, it would draw more beside it: seven, with less evidence."""
    monkeypatch.setattr(place_search, "LEAST_RESOLVED", 0.0)
    seen_m = in_box(400, 3)
    plain = session_at(rig, seen_m).observations
    dipoles_m = ((0.012, -0.004, 0.027), (0.027, -0.004, 0.01))
    moments_A_m2 = ((2e-3, 4e-3, -4e-3), (-3e-3, 2e-3, 4e-3))
    each_T = [
        magpylib.misc.Dipole(position=at_m, moment=moment).getB(seen_m)
        for at_m, moment in zip(dipoles_m, moments_A_m2, strict=True)
    ]
    shown_T = plain.field_sensor_T + plain.current_A[:, :1] * torch.from_numpy(sum(each_T))
    _, found = with_multipoles(rig, replace(plain, field_sensor_T=shown_T))
    np.testing.assert_allclose(sorted(found.places_m), dipoles_m, atol=1e-3)


def test_none_is_taken_where_none_is(rig, plain):
    same, found = with_multipoles(rig, plain.observations)
    assert found.places_m == ()
    assert same == rig
    assert same.hash == rig.hash


def test_readings_for_validation_are_not_looked_at(rig, observations, better):
    spoilt_T = observations.field_sensor_T + observations.is_validation[:, None] * 1.0
    _, found = with_multipoles(rig, replace(observations, field_sensor_T=spoilt_T))
    assert found == better[1]


def test_none_is_taken_where_the_readings_beside_it_are_missing(rig, observations, places_m, monkeypatch):
    is_far = np.linalg.norm(places_m - PLACE_M, axis=1) > 0.012
    far = observations.rows(torch.from_numpy(is_far))
    same, found = with_multipoles(rig, far)
    assert found == Found((), ())
    assert same == rig
    monkeypatch.setattr(place_search, "LEAST_RESOLVED", 0.0)
    assert len(with_multipoles(rig, far)[1].places_m) == 1  # so it was seen


def test_a_rig_with_more_that_is_free_is_refused(observations):
    text = TEXT.replace(
        "spacing_mm: 25", "spacing_mm: 25\n    world_from_coil: {x_mm: {prior: {normal: {mean: 0, sd: 1}}}}"
    )
    with pytest.raises(
        InvalidInput, match="must leave nothing free but amplitudes and the noise of one sensor"
    ):
        with_multipoles(rig_from_text(text), observations)

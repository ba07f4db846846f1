"""A magnet that the rig knows nothing of, calibrated by charges on a box: everything that is done with a calibration."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from estimator import SamplerSettings, calibrate
from estimator.calibration.next_degree import with_next_degree
from estimator.calibration.report import calibration_report
from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.rig.bodies import EquivalentSourceCoil
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.estimator.calibration.test_unwound import hidden_T, session_at

pytestmark = pytest.mark.whole

HALF_M = (0.03, 0.02, 0.02)
SETTINGS = SamplerSettings(target_ess=400.0)
TEXT = """
schema_version: 1
name: magnet of unknown build
movers: {stage: {motion: pose}}
coils:
  c1:
    model: equivalent_sources
    half_x_mm: 30
    half_y_mm: 20
    half_z_mm: 20
    margin_mm: 30
    spacing_mm: 18
    amplitudes: {sd_T_per_A: 5e-3}
sensors: {hall: {carried_by: stage, noise_uT: {prior: {log_normal: {median: 3, relative_sd: 1}}}}}
"""


def in_box(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 3)) * HALF_M


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(TEXT)


@pytest.fixture(scope="module")
def session(rig: Rig) -> Session:
    return session_at(rig, in_box(300, 1))


@pytest.fixture(scope="module")
def calibration(session: Session, rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    out = tmp_path_factory.mktemp("boxed") / "calibration"
    calibrate(session, rig, out=out, seed=1, settings=SETTINGS)
    return Calibration.load(out)


def test_unseen_places_are_predicted_and_lie_in_their_intervals(calibration):
    places_m = in_box(80, 99)
    true_T = torch.from_numpy(hidden_T(places_m))
    points_m = torch.from_numpy(places_m)
    assert float((calibration.field(points_m, {"c1": 1.0}) - true_T).norm() / true_T.norm()) < 1e-3
    lower, upper = calibration.field_interval(points_m, {"c1": 1.0})
    assert 0.8 < float(((lower <= true_T) & (true_T <= upper)).double().mean()) <= 1.0


def test_beyond_the_box_the_interval_grows_and_near_the_charges_there_is_none(calibration):
    points_m = torch.tensor([[x, 0.0, 0.0] for x in (0.0, 0.03, 0.044, 0.046)], dtype=torch.float64)
    lower, upper = calibration.field_interval(points_m, {"c1": 1.0})
    width_T = (upper - lower).amax(-1)
    assert bool(width_T[0] < width_T[1] < width_T[2])
    assert torch.isnan(width_T[3])


def test_the_summary_and_the_report_say_what_the_readings_tell(calibration):
    summary = calibration.summary()
    n = len(calibration.rig.unwound[0].amplitudes[1])
    assert summary["amplitudes"]["c1"]["free"] == n
    assert 20 < summary["amplitudes"]["c1"]["determined"] < n
    assert summary["next_degree_log_evidence"] < 3.0
    json.dumps(summary, allow_nan=False)
    page = calibration_report(calibration, "coilcal calibrate")
    assert f"of {n} amplitudes of c1" in page
    assert "<td>charges</td>" in page
    assert "Harmonics of c1" not in page


def test_charges_that_stand_too_far_off_are_said(rig, session):
    far = rig_from_text(
        TEXT.replace("margin_mm: 30", "margin_mm: 150").replace("spacing_mm: 18", "spacing_mm: 90")
    )
    one = calibrate(Session(far, session.observations, ""), far, seed=1, settings=SETTINGS)
    assert one.summary()["next_degree_log_evidence"] > 3.0
    closer = with_next_degree(rig)
    assert closer is not None
    coil = closer.unwound[0]
    assert isinstance(coil, EquivalentSourceCoil)
    assert (coil.margin_m, coil.spacing_m) == pytest.approx((0.024, 0.0144))
    names = set(coil.amplitudes[1])
    assert {p.name for p in closer.free if p.unit == "T/A"} == names
    assert {p.prior for p in closer.free if p.name in names} == {rig.parameters["c1.charge1_T_per_A"].prior}


def test_it_is_saved_and_its_export_refused(calibration, tmp_path):
    calibration.save(tmp_path / "again")
    again = Calibration.load(tmp_path / "again")
    points_m = torch.from_numpy(in_box(5, 0))
    torch.testing.assert_close(again.field(points_m, {"c1": 1.0}), calibration.field(points_m, {"c1": 1.0}))
    with pytest.raises(InvalidInput, match=r"c1 \(a coil without a winding\)"):
        calibration.export("json", tmp_path / "model.json")

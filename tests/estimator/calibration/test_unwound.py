"""A magnet that the rig knows nothing of, calibrated by harmonics: loops of magpylib stand for it."""

from __future__ import annotations

import json
from dataclasses import replace

import magpylib
import numpy as np
import pytest
import torch

from estimator import SamplerSettings, calibrate
from estimator.calibration.next_degree import CLEAR_LOG_EVIDENCE, with_next_degree
from estimator.calibration.result import Calibration
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.limits import Limits
from estimator.errors import InvalidInput
from estimator.model.simulate import draw_truth, simulate
from estimator.readings.plan import load_plan
from estimator.rig.parameters import Normal
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from estimator.store.importers.common import map_observations
from estimator.store.session import Session
from estimator.system.system import System

pytestmark = pytest.mark.whole

NOISE_T = 1e-6
RADIUS_M = 0.04
CURRENT_A = 2.0
SETTINGS = SamplerSettings(target_ess=400.0)
TEXT = """
schema_version: 1
name: magnet of unknown build
movers: {stage: {motion: pose}}
coils:
  c1:
    model: harmonic
    region: interior
    degree: 10
    reference_radius_mm: 40
    amplitudes: {sd_T_per_A: 5e-3, falloff: 0.5}
sensors: {hall: {carried_by: stage, noise_uT: {prior: {log_normal: {median: 3, relative_sd: 1}}}}}
"""
HIDDEN = [
    magpylib.current.Circle(diameter=0.18, current=400.0, position=(0.02, 0.0, -0.09)).rotate_from_angax(
        20, "x"
    ),
    magpylib.current.Circle(diameter=0.10, current=300.0, position=(-0.01, 0.12, 0.05)).rotate_from_angax(
        70, "y"
    ),
]


def hidden_T(places_m: np.ndarray) -> np.ndarray:
    """Field of one ampere in a magnet of two loops of 400 and 300 turns."""
    return np.sum([loop.getB(places_m) for loop in HIDDEN], axis=0)


def in_ball(n: int, seed: int) -> np.ndarray:
    places = np.random.default_rng(seed).uniform(-1.0, 1.0, (4 * n, 3))
    return RADIUS_M * places[np.linalg.norm(places, axis=1) < 1.0][:n]


def session_at(rig: Rig, places_m: np.ndarray, seed: int = 0) -> Session:
    """Readings of the hidden magnet with noise."""
    n, rng = len(places_m), np.random.default_rng(seed)
    field_T = CURRENT_A * hidden_T(places_m) + rng.normal(0.0, NOISE_T, (n, 3))
    pose = torch.from_numpy(np.concatenate((places_m, np.zeros((n, 3))), 1))
    observations = map_observations(rig, [CURRENT_A], pose, torch.from_numpy(field_T))
    return Session(rig, observations, "two loops of magpylib")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(TEXT)


@pytest.fixture(scope="module")
def calibration(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    out = tmp_path_factory.mktemp("unwound") / "calibration"
    calibrate(session_at(rig, in_ball(240, 1)), rig, out=out, seed=1, settings=SETTINGS)
    return Calibration.load(out)


def test_places_held_out_are_predicted_to_a_part_in_a_thousand(calibration):
    places_m = 0.9 * in_ball(60, 99)
    true_T = torch.from_numpy(hidden_T(places_m))
    error_T = calibration.field(torch.from_numpy(places_m), {"c1": 1.0}) - true_T
    assert float(error_T.norm() / true_T.norm()) < 1e-3


@pytest.mark.slow
def test_intervals_at_places_held_out_hold_their_share(rig):
    held = []
    places_m = 0.9 * in_ball(60, 99)
    true_T = torch.from_numpy(hidden_T(places_m))
    points_m = torch.from_numpy(places_m)
    for seed in range(8):  # the errors of one calibration go together from place to place
        session = session_at(rig, in_ball(240, seed), seed)
        one = calibrate(session, rig, seed=seed, settings=replace(SETTINGS, target_ess=200.0))
        assert one.summary()["is_converged"]
        lower, upper = one.field_interval(points_m, {"c1": 1.0})
        held.append(((lower <= true_T) & (true_T <= upper)).double().mean())
        assert one.summary()["next_degree_log_evidence"] < CLEAR_LOG_EVIDENCE
    assert 0.85 < float(torch.stack(held).mean()) < 0.95


def test_too_low_a_degree_is_said(rig):
    """Its intervals are too narrow, for the field is finer than the degree allows."""
    low = rig_from_text(TEXT.replace("degree: 10", "degree: 6"))
    one = calibrate(session_at(low, in_ball(240, 1)), low, seed=1, settings=SETTINGS)
    assert one.summary()["next_degree_log_evidence"] > 50.0
    verdict = one.summary()["quality"]
    assert verdict["verdict"] == "suspect"
    assert "finer field than its degree allows" in verdict["reasons"][-1]
    wide = rig_from_text(TEXT.replace("degree: 10", "degree: 8"))
    hidden_by_width = calibrate(session_at(wide, in_ball(240, 1)), wide, seed=1, settings=SETTINGS)
    assert (
        hidden_by_width.summary()["next_degree_log_evidence"] > 10.0
    )  # a prior as wide as the next one has would say no
    found = with_next_degree(rig)
    assert found is not None
    assert found.unwound[0].degree == 11
    assert found.parameters["c1.degree11_cos0_T_per_A"].prior == Normal(0.0, 5e-3 * 0.5**10)


def test_the_noise_is_found_and_the_summary_says_what_the_readings_tell(calibration):
    summary = calibration.summary()
    low, high = summary["parameters"]["hall.noise_T"]["ci90"]
    assert 0.9 * NOISE_T < low < NOISE_T < high < 1.1 * NOISE_T
    assert summary["amplitudes"] == {"c1": {"free": 120, "determined": 120}}
    assert summary["coverage90"]["calibration"] == pytest.approx(
        0.93, abs=0.03
    )  # fitted readings, which pull it
    assert set(calibration.draws) == {p.name for p in calibration.rig.free}
    json.dumps(summary, allow_nan=False)


def test_away_from_the_readings_the_prior_comes_back(rig):
    """Readings in a plane and its mirror's field: off the plane some terms are not told, and their interval is that of the prior."""
    places_m = in_ball(200, 3) * [1.0, 1.0, 0.0]
    session = session_at(rig, places_m)
    z_only = session.observations.field_sensor_T.clone()
    z_only[:, :2] = torch.nan  # a probe of one component: nothing tells how it changes across the plane
    session = replace(session, observations=replace(session.observations, field_sensor_T=z_only))
    one = calibrate(session, rig, seed=1, settings=SETTINGS)
    line_m = torch.tensor([[0.0, 0.0, z_m] for z_m in (0.0, 0.02, 0.04, 0.08)], dtype=torch.float64)
    width_T = torch.sub(*reversed(one.field_interval(line_m, {"c1": 1.0})))
    priors = {p.name: p.prior for p in rig.free if p.prior}
    rng = np.random.default_rng(0)
    prior_draws = {name: prior.sample(rng, 6400).reshape(32, 200) for name, prior in priors.items()}
    unread = replace(one, draws=prior_draws, log_prob=np.zeros((32, 200)))
    prior_T = torch.sub(*reversed(unread.field_interval(line_m, {"c1": 1.0})))
    ratio = width_T / prior_T
    assert float(ratio[0, 2]) < 0.01
    assert ((ratio[1:] > 0.3) & (ratio[1:] < 1.2)).any(-1).all()
    assert float(ratio[0, 0]) == pytest.approx(1.0, abs=0.2)  # Bx was never read
    assert (width_T[1:, 2] > 1.5 * width_T[:-1, 2]).all()


def test_beyond_the_readings_the_interval_grows_until_it_is_that_of_the_highest_degree(calibration):
    points_m = torch.tensor([[r, 0.0, 0.0] for r in (0.02, 0.04, 0.06, 0.09)], dtype=torch.float64)
    lower, upper = calibration.field_interval(points_m, {"c1": 1.0})
    width_T = (upper - lower).amax(-1)
    assert (width_T[1:] > 3.0 * width_T[:-1]).all()


def test_the_gradient_is_symmetric_and_traceless_and_right(calibration):
    places_m, step_m = in_ball(20, 5) * 0.7, 1e-5
    gradient = calibration.gradient(torch.from_numpy(places_m), {"c1": 1.0}).numpy()
    steps = step_m * np.eye(3)
    expected = np.stack([(hidden_T(places_m + s) - hidden_T(places_m - s)) / (2 * step_m) for s in steps], -1)
    size = np.abs(expected).max()
    assert np.abs(gradient - expected).max() < 0.02 * size
    assert np.abs(np.trace(gradient, axis1=1, axis2=2)).max() < 1e-12 * size
    assert np.abs(gradient - gradient.swapaxes(1, 2)).max() < 1e-12 * size


def test_a_system_of_it_makes_a_wanted_field(calibration):
    system = System.of(calibration)
    here_m = torch.zeros(1, 3, dtype=torch.float64)
    at = system.at(here_m)
    matrix = at.actuation()
    torch.testing.assert_close(matrix[0, :3, 0], calibration.field(here_m, {"c1": 1.0})[0])
    wanted_T = 2.5 * torch.from_numpy(hidden_T(np.zeros((1, 3))))
    assert float(at.currents_for_field(wanted_T)[0, 0]) == pytest.approx(2.5, rel=1e-3)
    lower, upper = at.field_interval_T(torch.tensor([1.0]).double())
    assert (lower < upper).all()


def test_it_is_saved_and_written_back_with_what_was_found(calibration, tmp_path):
    calibration.save(tmp_path / "again")
    again = Calibration.load(tmp_path / "again")
    assert again.rig == calibration.rig
    points_m = torch.from_numpy(in_ball(5, 0))
    torch.testing.assert_close(again.field(points_m, {"c1": 1.0}), calibration.field(points_m, {"c1": 1.0}))
    found = calibration.rig.with_values(calibration.best).with_fixed(p.name for p in calibration.rig.free)
    assert rig_from_text(rig_text(found)) == found


def test_with_a_known_noise_nothing_is_left_to_sample(rig):
    fixed = rig.with_fixed(["hall.noise_T"]).with_values({"hall.noise_T": NOISE_T})
    one = calibrate(session_at(fixed, in_ball(240, 1)), fixed, seed=1, settings=SETTINGS)
    assert one.summary()["is_converged"]
    assert one.summary()["coverage90"]["calibration"] == pytest.approx(0.93, abs=0.03)
    assert one.log_prob.size >= 400


def test_readings_of_a_simulated_one_give_its_amplitudes_back(rig, tmp_path):
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN)
    truth = draw_truth(rig, np.random.default_rng(3))
    session = Session(rig, simulate(rig, load_plan(plan, rig), truth, seed=3), "simulated", truth=truth)
    one = calibrate(session, rig, seed=1, settings=SETTINGS)
    held = [
        low <= session.truth[name] <= high
        for name, entry in one.summary()["parameters"].items()
        for low, high in [entry["ci90"]]
    ]
    assert 0.75 < np.mean(held) <= 1.0


def test_too_few_readings_are_refused(rig):
    with pytest.raises(
        InvalidInput, match=r"at least as many components as there are free parameters \(121\)"
    ):
        calibrate(session_at(rig, in_ball(40, 1)), rig, settings=SETTINGS)


def test_single_precision_is_refused_for_differences_of_predictions(rig):
    with pytest.raises(InvalidInput, match="coils without a winding must be calibrated in double precision"):
        calibrate(session_at(rig, in_ball(150, 1)), rig, settings=SETTINGS, precision="single")


def test_a_diagnosis_of_it_names_no_cause_and_asks_none_of_a_winding():
    low = rig_from_text(TEXT.replace("degree: 10", "degree: 4"))
    session = session_at(low, 0.5 * in_ball(150, 1))
    result = diagnose(session, low, seed=1, limits=Limits(most_causes=1))
    assert all(not c.cause.name.startswith("winding") for c in result.findings.causes)
    json.dumps(result.to_json())


PLAN = """
schema_version: 1
name: box
poses:
  calibration:
    stage:
      x_mm: {from: -20, to: 20, count: 5}
      y_mm: {from: -20, to: 20, count: 5}
      z_mm: {from: -20, to: 20, count: 5}
currents_A: [{c1: 2}]
"""

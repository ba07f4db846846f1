"""Places of a map determine a correction that the readings so far cannot, and no sensor meets a winding on the way."""

from __future__ import annotations

import pytest
import torch

from estimator import Design, InvalidInput, Session, design, load_plan, simulate
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.next_readings.map_places import with_correction
from estimator.model.clearance import clearance_m
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from tests.estimator.diagnosis.sessions import RIG, TRUTH, session_with, together

HARMONICS, N = "coil_harmonics[coil1]", 12


@pytest.fixture(scope="module")
def flat() -> Session:
    """Readings in one plane only."""
    session = session_with((), (3.0,), 1)
    x_m = session.observations.motion["arm1"][:, 0]
    return Session(RIG, session.observations.rows(x_m == x_m[0]), "one plane")


@pytest.fixture(scope="module")
def proposed(flat: Session) -> Design:
    return design(flat, correction=HARMONICS, degree=2, n_readings=N)


def test_a_map_leaves_the_plane_and_stays_in_the_ball(flat, proposed):
    before_m, after_m = flat.observations.motion["arm1"][:, :3], proposed.readings.motion["arm1"][:, :3]
    middle_m = 0.5 * (before_m.amax(0) + before_m.amin(0))
    radius_m = 0.5 * float((before_m.amax(0) - before_m.amin(0)).max())
    assert float((after_m - middle_m).norm(dim=-1).max()) <= radius_m + 1e-9
    assert float((after_m[:, 0] - middle_m[0]).abs().max()) > 0.6 * radius_m
    assert bool((torch.diff(torch.tensor([proposed.so_far, *proposed.reached])) <= 0.0).all())


def test_the_plane_again_would_not_do(flat, proposed):
    fit = fit_rig(RIG, flat.observations, TRUTH, MeasurementModel.build(RIG, flat.observations).rules)
    rms = [
        rms_sd(*with_correction(base, HARMONICS, 2)) for base in (fit, with_readings(flat, flat.observations))
    ]
    assert rms[0] == pytest.approx(proposed.so_far, rel=1e-6)
    assert proposed.reached[-1] < 0.85 * rms[1]


def test_what_is_foretold_is_what_a_fit_to_the_places_gives(flat, proposed, tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text(proposed.plan)
    more = simulate(RIG, load_plan(path, RIG), TRUTH, 5)
    assert len(more) == N
    corrected, names = with_correction(
        fit_rig(RIG, flat.observations, TRUTH, MeasurementModel.build(RIG, flat.observations).rules),
        HARMONICS,
        2,
    )
    both = together(flat.observations, more)
    fit = fit_rig(corrected.rig, both, corrected.values, MeasurementModel.build(RIG, both).rules)
    assert rms_sd(fit, names) == pytest.approx(proposed.reached[-1], rel=0.15)


def test_no_place_is_nearer_to_the_winding_than_a_reading_was(flat, proposed):
    def nearest_m(readings: Observations) -> float:
        return float(clearance_m(MeasurementModel.unruled(RIG, readings)).min())

    assert nearest_m(proposed.readings) >= nearest_m(flat.observations) > 0.0


@pytest.mark.parametrize(
    ("correction", "degree", "words"),
    [
        ("axis_gain", 2, r"must name a correction \(axis_curves"),
        ("coil_harmonics[coil2]", 2, "coil1"),
        (HARMONICS, 9, "degree of coil_harmonics must lie between 1 and 5; received 9"),
    ],
)
def test_maps_that_make_no_sense_are_refused(flat, correction, degree, words):
    with pytest.raises(InvalidInput, match=words):
        design(flat, correction=correction, degree=degree)


def rms_sd(fit: Fit, names: list[str]) -> float:
    return float(torch.tensor([fit.value_sd(name) for name in names]).square().mean().sqrt())


def with_readings(session: Session, more: Observations) -> Fit:
    both = together(session.observations, more)
    return fit_rig(RIG, both, TRUTH, MeasurementModel.build(RIG, both).rules)

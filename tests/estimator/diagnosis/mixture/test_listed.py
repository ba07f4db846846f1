"""Items of listed causes: their priors, and places between those at which causes start."""

from __future__ import annotations

import math

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.mixture.dictionary import dictionary
from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.listed import _weighed, present_items, starts_of
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.mixture.weighed import weighed
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

BODY = Cause("iron_body", "room")
PLACE_M = {"x_m": 0.03, "y_m": -0.05, "z_m": 0.05}


def test_a_place_between_starts_is_found(small_rig, small_truth, small_session):
    """A piece of iron, in the linear model about the rig without it."""
    truth = small_rig.with_values(small_truth)
    readings = small_session.observations.calibration
    wrong = with_wrong(truth, readings, BODY, {**PLACE_M, "volume_m3": 3e-5})
    fit = fit_of(truth, wrong)
    coarse_m = torch.tensor(
        [[c.shapes[key] for key in PLACE_M] for c in candidates(fit, [BODY])], dtype=torch.float64
    )
    place_m = torch.tensor(list(PLACE_M.values()), dtype=torch.float64)
    nearest_m = float((coarse_m - place_m).norm(dim=1).min())
    value, item = weighed(fit, [BODY])[BODY]
    found_m = torch.tensor([item.start[key] for key in PLACE_M], dtype=torch.float64)
    assert value > 20.0
    assert float((found_m - place_m).norm()) < 0.3 * nearest_m


def test_a_place_that_explains_by_negative_iron_is_not_preferred(small_rig, small_truth, small_session):
    """Readings that differ from the rig's as iron does, with the other sign, offer no iron that they would call sure."""
    truth = small_rig.with_values(small_truth)
    readings = small_session.observations.calibration
    iron = with_wrong(truth, readings, BODY, {**PLACE_M, "volume_m3": 3e-5})
    fit = fit_of(truth, readings.with_field(2.0 * readings.field_sensor_T - iron.field_sensor_T))
    starts = starts_of(fit, candidates(fit, [BODY]))
    best = max(of_start.best for of_start in _weighed(fit, starts)[BODY])
    made = dictionary(Expansion.of(fit), present_items(starts), [])
    log_prior = torch.tensor([item.log_prior for item in made.items], dtype=torch.float64)
    exact = Products(made).beside([], 1.0) + log_prior - math.log(policy.LISTED)
    assert best == pytest.approx(float(exact.max()), abs=0.01)

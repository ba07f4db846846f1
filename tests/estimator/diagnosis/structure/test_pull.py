"""A number that the readings pull far from its prior is noticed, by as much evidence as fits with wider priors have for them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.step import leaves_structure
from estimator.diagnosis.structure.pull import pull_of
from estimator.rig.parameters import Normal
from tests.estimator.diagnosis.sessions import RIG, plain_fit

pytestmark = pytest.mark.whole
PLACE, SD_M = "coil1.world_from_coil0.x_m", 1.5e-5  # the readings know it to 0.9e-5


def with_place(off_sd: float, widened: float = 1.0) -> Fit:
    """The plain session, fitted with a place whose stated prior lies so many of its widths from the truth."""
    prior = Normal(float(plain_fit().values[PLACE]) - off_sd * SD_M, widened * SD_M)
    rig = RIG.with_parameters([replace(RIG.parameters[PLACE], prior=prior, value=prior.mean)])
    base = plain_fit()
    return fit_rig(rig, base.observations, base.values, base.posterior.model.rules)


def test_right_priors_leave_nothing() -> None:
    assert not leaves_structure(pull_of(plain_fit()))
    assert not leaves_structure(pull_of(with_place(1.0)))


def test_a_number_outside_its_prior_is_told_with_the_number() -> None:
    pull = pull_of(with_place(7.0))
    assert leaves_structure(pull)
    assert pull.name == PLACE
    assert pull.widths == pytest.approx(7.0, abs=0.5)  # though the fit has gone only a part of that way


@pytest.mark.parametrize("wider", [4.0, 16.0])
def test_the_evidence_is_that_of_fits_with_a_wider_prior(
    monkeypatch: pytest.MonkeyPatch, wider: float
) -> None:
    monkeypatch.setattr(policy, "WIDER_PRIORS", (wider,))
    stated, wide = with_place(7.0), with_place(7.0, wider)
    by_fits = wide.log_evidence - stated.log_evidence - math.log(wider)
    n_numbers = sum(not parameter.name.endswith("noise_T") for parameter in stated.rig.free)
    by_pull = pull_of(stated).log_bayes_factor + math.log(n_numbers)
    assert by_pull == pytest.approx(by_fits, rel=0.1)

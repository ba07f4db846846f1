"""Causes that change the scatter of readings: when they are fitted, and how they are told apart."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.asking import asked_beside_mistakes
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.noise import noise_causes
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.next_readings.expected_evidence import rows_seen, separation
from estimator.diagnosis.progress import unwatched
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import fit_of, unheard, with_wrong

pytestmark = pytest.mark.whole

SPHERICAL = Cause("spherical_sum", "coil1")


@pytest.fixture(scope="module")
def biased(small_rig, small_session) -> Fit:
    """A wrong sum of the loops, which grows towards the coil as the scatter of a mover does."""
    seen = small_session.observations.calibration
    return fit_of(small_rig, with_wrong(small_rig, seen, SPHERICAL, {"weight": 1.0}))


def test_evidence_of_a_scatter_is_that_of_its_full_fit(biased):
    (cause, value, fit), *_ = [row for row in noise_causes(biased) if row[0].name == "position_jitter"]
    assert value == pytest.approx(fit.log_evidence - biased.log_evidence)
    assert cause in fit.rig.effects


def test_where_readings_scatter_as_they_should_no_scatter_is_fitted(small_rig, small_session):
    assert noise_causes(fit_of(small_rig, small_session.observations.calibration)) == []


def test_what_tells_two_scatters_apart_is_the_divergence_of_two_normal_distributions(
    small_rig, small_session
):
    seen = small_session.observations.calibration
    plain = fit_of(small_rig, seen)
    moved = Cause("position_jitter", small_rig.movers[0].name)
    wider = with_effect(plain.rig, moved, seen, {"sd_m": 2e-4}, is_free=False)
    scattered = fit_of(wider, seen)
    fits = {"plain": plain, "scattered": scattered}
    rows = rows_seen(fits)
    ratio2 = (rows[0].sigma_T / rows[1].sigma_T).square()
    expected = 0.5 * (ratio2 - 1.0 - ratio2.log()).sum()
    assert expected > 1.0
    torch.testing.assert_close(separation(fits, rows)[0], expected, rtol=0.2, atol=0.0)


def test_what_shows_is_asked_with_the_weights_that_a_cause_of_scatter_gives(small_rig, small_session):
    """A gain of the current hides in the loops, free by 1 in 12, until it is some widths of that, however the noise grows."""
    seen = small_session.observations.calibration
    generator = torch.Generator().manual_seed(1)
    shares = 0.02 * torch.randn(len(seen), 3, dtype=torch.float64, generator=generator)
    plain = fit_of(small_rig, seen.with_field(seen.field_sensor_T * (1.0 + shares)))
    said = asked_beside_mistakes(plain, None, Limits(), 1, unheard, unwatched)
    assert [named.cause.name for named in said.said.given] == ["noise_grows"]
    (gain,) = [visible for visible in said.visible if visible.cause.name == "current_gain"]
    assert gain.size > 3.0 / 12.0

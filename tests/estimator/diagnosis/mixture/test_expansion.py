"""The linear model about a fit with causes: at the fit it is the fit, and without the causes it is what they leave."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.climb import ask, noise_prior
from estimator.diagnosis.mixture.confirmed import answer
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.naming import fitted_with_stated, named_by
from estimator.effects.attach import with_effect
from estimator.rig.parameters import LogNormal, Normal, Uniform
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

OFFSET, BODY = Cause("sensor_offset", "hall"), Cause("iron_body", "room")
AT = {"x_m": 0.02, "y_m": -0.03, "z_m": 0.16}


@pytest.fixture(scope="module")
def seen(small_session):
    return small_session.observations.calibration


def expansion_with(rig, readings, cause, given):
    """The expansion about a fit with one cause, where the readings have it."""
    plain = fit_of(rig, with_wrong(rig, readings, cause, given))
    asked = ask(Expansion.of(plain), Limits(), 1, {})
    items = asked.dictionary.items
    own = [i for i, item in enumerate(items) if item.cause == cause]
    chosen = max(own, key=lambda i: float(asked.slots.products.beside([], 1.0)[i]))
    sizes, _ = asked.slots.products.sizes([chosen], 1.0)
    return asked.expansion.moved(asked.dictionary, [chosen], sizes)


def test_without_causes_the_residual_is_that_of_the_rig_at_its_prior_means(small_rig, seen):
    expansion = Expansion.of(fit_of(small_rig, seen))
    rest = expansion.always.rest(expansion.residual)
    assert torch.allclose(rest, expansion.fit.residual, atol=1e-4)
    assert not expansion.present


def test_a_linear_cause_of_the_fit_has_no_shift_and_its_size_is_that_of_the_fit(small_rig, seen):
    expansion = expansion_with(small_rig, seen, OFFSET, {"x_T": 2e-4, "y_T": -1e-4, "z_T": 0.0})
    (start,) = expansion.present
    assert start.candidate.cause == OFFSET
    assert float(start.candidate.shift.norm()) < 1e-6 * float(start.candidate.columns.norm() * 2e-4)
    fitted = torch.stack([expansion.fit.values[f"{OFFSET.label}.{key}"] for key in start.candidate.keys])
    left = expansion.residual - start.candidate.columns @ fitted
    assert torch.allclose(expansion.always.rest(left), expansion.fit.residual, atol=1e-3)


def test_the_answer_names_the_cause_and_the_fit_with_it_has_its_size(small_rig, seen):
    readings = with_wrong(small_rig, seen, OFFSET, {"x_T": 2e-4, "y_T": -1e-4, "z_T": 1e-4})
    found = answer(fit_of(small_rig, readings), Limits(), seed=1, n_pairs=1)
    (named,) = named_by(found)
    assert "sensor_offset" in {named.cause.name, *(other.cause.name for other in named.alternatives)}
    assert named.probability + sum(o.probability for o in named.alternatives) >= 0.9
    fit = fitted_with_stated(found)
    assert fit.rig.effects == (named.cause,)
    assert fit.log_evidence > found.asked.expansion.plain.log_evidence + 50.0


def test_rows_that_were_shifted_in_the_record_are_asked_too(small_rig, seen):
    shifted = Cause("rows_shifted", "record")
    rig = with_effect(small_rig, shifted, seen, {"rows": 1.0}, is_free=False)
    readings = with_wrong(small_rig, seen, OFFSET, {"x_T": 2e-4, "y_T": -1e-4, "z_T": 1e-4})
    late = readings.with_field(torch.roll(readings.field_sensor_T, 1, dims=0))
    found = answer(fit_of(rig, late), Limits(), seed=1, n_pairs=1)
    assert shifted in found.asked.expansion.plain.rig.effects
    assert found.found


@pytest.mark.parametrize(
    ("prior", "width", "p_misstated"),
    [
        (LogNormal(5e-6, 0.5), 0.5, 0.0),
        (Normal(5e-6, 1e-6, lower=1e-7), 1.0, 0.0),
        (Uniform(1e-6, 9e-6), 1.0, 0.0),
        (None, 0.0, 0.05),
    ],
)
def test_a_noise_with_any_prior_is_not_known(small_rig, seen, prior, width, p_misstated):
    noise = replace(small_rig.parameters["hall.noise_T"], value=5e-6, prior=prior)
    prior_of_noise = noise_prior(fit_of(small_rig.with_parameters([noise]), seen))
    assert (prior_of_noise.width, prior_of_noise.p_misstated) == (width, p_misstated)

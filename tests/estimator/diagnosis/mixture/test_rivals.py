"""Causes in the place of a stated one, judged by full fits."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture import rivals as rivals_module
from estimator.diagnosis.mixture.confirmed import with_rivals
from estimator.diagnosis.mixture.full_fits import fit_with
from estimator.diagnosis.mixture.rivals import MOST_RIVALS, Rival, contenders
from estimator.diagnosis.policy import WIDTHS
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import answered, fit_of, with_wrong

pytestmark = pytest.mark.whole

GAIN, SCALE = Cause("axis_gain", "hall"), Cause("robot_scale", "arm1")


@pytest.fixture(scope="module")
def answer(small_rig, small_session, small_truth):
    truth = small_rig.with_values(small_truth)
    return answered(
        fit_of(small_rig, with_wrong(truth, small_session.observations.calibration, GAIN, {"z": 0.05}))
    )


def test_a_rival_takes_its_share_of_the_name_by_its_evidence(answer):
    alone = replace(answer, rivals={})
    (entry,) = alone.stated
    first = entry.first_listed
    rival = Rival(SCALE, alone.item_of(SCALE), math.log(0.25), {})
    (shared,) = replace(answer, rivals={first: (rival,)}).stated
    shares = {possibility.cause: possibility.share for possibility in shared.possibilities}
    assert shares[SCALE] == pytest.approx(0.25 * shares[first])
    assert shared.listed_share == pytest.approx(entry.listed_share)
    assert shared.probability == entry.probability


def test_contenders_have_half_of_the_evidence_and_are_not_in_the_set(answer):
    first = answer.stated[0].first_listed
    comparison = answer.beside_item(answer.item_of(first), [first])
    factors = {h.cause: h.log_bayes_factor for h in comparison.hypotheses}
    able = contenders(comparison, first, [])
    assert len(able) <= MOST_RIVALS
    assert all(factors[each.cause] > 0.5 * factors[first] for each in able)
    without = contenders(comparison, first, [each.cause for each in able])
    assert not {each.cause for each in able} & {each.cause for each in without}


def test_odds_of_rivals_are_those_of_full_fits(answer, monkeypatch):
    """Of causes with far less evidence too, so that there are some; a start that the fit keeps has its share of the prior, and so has a
    size that only the widest prior allows."""
    monkeypatch.setattr(rivals_module, "LEAST_EVIDENCE", -10.0)
    monkeypatch.setattr(policy, "ALTERNATIVE", 0.0)
    compared = with_rivals(answer)
    extent = compared.plain.posterior.model.circumstances.extent
    assert compared.rivals
    for first, rivals in compared.rivals.items():
        for rival in rivals:
            own, other = (fit_with(compared, [cause]) for cause in (first, rival.cause))
            n_starts = sum(candidate.cause == rival.cause for candidate in compared.asked.pool)
            has_free_shape = any(
                q.is_shape and not q.is_fixed for q in EFFECTS[rival.cause.name].quantities(extent)
            )
            log_prior = 0.0 if has_free_shape else -math.log(n_starts)
            log_prior += width_prior(other, rival.cause) - width_prior(own, first)
            assert rival.log_odds == pytest.approx(other.log_evidence + log_prior - own.log_evidence, abs=0.2)


def width_prior(fit: Fit, cause: Cause) -> float:
    """Log prior odds of the width of a cause's sizes in a fit, against the stated width."""
    widths = dict(WIDTHS)
    for quantity in EFFECTS[cause.name].quantities(fit.posterior.model.circumstances.extent):
        prior = fit.rig.parameters[f"{cause.label}.{quantity.key}"].prior
        if not quantity.is_shape and prior is not None:
            factor = round(prior.sd / quantity.prior.sd, 6)
            return math.log(widths[factor] / widths[1.0])
    return 0.0

"""Two causes tested together: the algebra of the batch, and a pair in which one hides the other."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates
from estimator.diagnosis.hypotheses.pairs import pairs
from estimator.diagnosis.hypotheses.screening import linear_evidence
from estimator.diagnosis.linear import log_bayes_factor
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole

ASKED = [Cause("axis_gain", "hall"), Cause("sensor_offset", "hall"), Cause("cross_axis", "hall")]


@pytest.fixture(scope="module")
def base(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations.calibration)


@pytest.fixture(scope="module")
def pool(base: Fit) -> list[Candidate]:
    return candidates(base, ASKED)


def with_residual(fit: Fit, residual: torch.Tensor) -> Fit:
    """The fit with other whitened residuals, less what it can follow."""
    copy = Fit(fit.posterior, fit.optimum)
    projector = fit.projector
    followed = projector.factor @ (projector.factor.T @ (fit.jacobian.T @ residual))
    copy.__dict__.update(projector=projector, residual=residual - fit.jacobian @ followed)
    return copy


def test_pair_has_the_evidence_of_its_columns_side_by_side(base, pool):
    for value, first, second in pairs(base, pool):
        columns = torch.cat((first.columns, second.columns), dim=1)
        direct = log_bayes_factor(
            base.projector.gram(columns, columns),
            columns.T @ base.residual,
            torch.cat((first.prior_sd, second.prior_sd)),
            base.free_noise,
        )
        assert value == pytest.approx(float(direct), abs=1e-6)


def test_every_two_causes_are_asked_once_and_no_cause_with_itself(base, pool):
    asked = [{first.cause, second.cause} for _, first, second in pairs(base, [*pool, *pool])]
    assert all(len(pair) == 2 for pair in asked)
    assert len(asked) == 4 * len(pairs(base, pool))


def test_two_causes_that_hide_each_other_are_found_together(base, pool):
    first = next(c for c in pool if c.cause.name == "axis_gain")
    u = first.columns[:, :1]
    size = float(base.projector.gram(u, u).sqrt())
    v = 0.995 * u / size + 0.1 * torch.nn.functional.normalize(
        torch.randn(len(u), 1, dtype=torch.float64, generator=torch.Generator().manual_seed(1)), dim=0
    )
    first = replace(
        first, keys=("x",), units=("1",), columns=u / size, prior_sd=torch.full((1,), 100.0).double()
    )
    second = replace(first, cause=ASKED[1], columns=v)
    difference = (u / size - v)[:, 0]
    noisy = with_residual(base, base.residual + 80.0 * difference)
    together = pairs(noisy, [first, second])[0][0]
    alone = max(linear_evidence(noisy, (first, second)))
    assert together > 20.0
    assert together > alone + 15.0


def test_one_cause_alone_makes_no_pair(base, pool):
    assert pairs(base, pool[:1]) == []


@pytest.mark.parametrize(
    "cause", [Cause("iron_plate", "room"), Cause("coil_heating", "coil1"), Cause("sensor_bumped", "hall")]
)
def test_starts_of_a_cause_have_the_columns_that_each_has_alone(base, cause, monkeypatch):
    """Most causes predict all their starts at once; here, the starts are given one by one."""
    together = candidates(base, [cause])
    effect = EFFECTS[cause.name]
    assert len(together) > 1
    for candidate in together:
        monkeypatch.setattr(type(effect), "starts", lambda *_, shapes=candidate.shapes: (shapes,))
        (alone,) = candidates(base, [cause])
        torch.testing.assert_close(alone.columns, candidate.columns, rtol=1e-9, atol=0.0)
        torch.testing.assert_close(alone.shift, candidate.shift, rtol=1e-9, atol=1e-12)


def test_pairs_that_reach_the_least_evidence_are_those_of_all_that_exceed_it(base, pool):
    """The bound leaves out none of them."""
    noise = torch.randn(len(base.residual), dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    for size in (0.0, 0.3, 3.0):
        disturbed = with_residual(base, base.residual + size * noise * (1.0 + pool[0].columns[:, 0].abs()))
        everything = pairs(disturbed, pool)
        for least in (everything[0][0] - 1e-9, everything[len(everything) // 2][0], -100.0):
            expected = [(value, first, second) for value, first, second in everything if value > least]
            ranked = pairs(disturbed, pool, least)
            assert [value for value, _, _ in ranked] == pytest.approx([value for value, _, _ in expected])
            assert [p[1:] for p in ranked] == [p[1:] for p in expected]

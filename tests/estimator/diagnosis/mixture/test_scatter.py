"""Causes of scatter are stated where readings scatter otherwise than the rig says, and where nothing else is left."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.scatter import BesideScatter, _named, answer_beside_scatter
from estimator.diagnosis.outcome import Outcome
from estimator.diagnosis.verdict import NamedCause, Verdict
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T, unheard, with_wrong

pytestmark = pytest.mark.whole

GROWS = Cause("noise_grows", "hall")
OUTLIERS, JITTER, OFFSET = (
    Cause("outliers", "hall"),
    Cause("position_jitter", "arm1"),
    Cause("sensor_offset", "hall"),
)
NOISE_T = 5e-6
NO_MISTAKES: tuple[NamedCause, ...] = ()


@pytest.fixture(scope="module")
def rig(rig_text: str) -> Rig:
    """The small rig, whose noise is known to a half."""
    return rig_from_text(
        rig_text.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}")
    )


@pytest.fixture(scope="module")
def readings(rig: Rig, small_plan: Plan, small_truth: dict[str, float]) -> Observations:
    """81 readings, each place three times, in any order."""
    plan = replace(small_plan, repeats=3, order="random")
    return simulate(rig, plan, {**small_truth, "hall.noise_T": NOISE_T}, seed=3).calibration


def said_of(rig: Rig, readings: Observations) -> tuple[BesideScatter, Outcome]:
    plain = fit_of(rig, readings)
    said = answer_beside_scatter(plain, Limits(), 1, unheard)
    return said, Outcome.of(plain, said, NO_MISTAKES, is_record_wrong=False)


def wild(readings: Observations, is_wild: Tensor) -> Observations:
    """Components that miss by twenty times the noise."""
    generator = torch.Generator().manual_seed(5)
    error_T = 20.0 * NOISE_T * torch.randn(is_wild.shape, generator=generator, dtype=torch.float64)
    return readings.with_field(readings.field_sensor_T + is_wild * error_T)


def test_wild_readings_here_and_there_are_outliers_beside_which_a_cause_keeps_its_name(rig, readings):
    is_wild = torch.rand(len(readings), 3, generator=torch.Generator().manual_seed(1)) < 0.06
    off = with_wrong(rig, readings, OFFSET, {"x_T": 40e-6, "y_T": -30e-6})
    said, outcome = said_of(rig, wild(off, is_wild))
    (scattering,) = said.given
    assert scattering.cause == OUTLIERS
    assert scattering.probability > 0.9
    assert scattering.log_bayes_factor > 20.0
    assert OUTLIERS in said.answer.plain.rig.effects
    assert len(outcome.named) == 2
    told = [
        cause for named in outcome.named for cause in (named.cause, *(o.cause for o in named.alternatives))
    ]
    assert OFFSET in told
    assert not outcome.verdict.leaves_something


def test_a_mover_that_does_not_stop_where_it_says_is_told_from_noise(rig, readings, small_truth):
    """Readings of a rig whose mover misses by 0.6 mm, by another amount each time: no error of a stop; the more, the steeper the field."""
    truth = rig.with_values(small_truth)
    motion = readings.motion["arm1"].clone()
    generator = torch.Generator().manual_seed(2)
    motion[:, :3] += 6e-4 * torch.randn(len(motion), 3, generator=generator, dtype=torch.float64)
    from_there = replace(readings.alone, motion={"arm1": motion})
    moved_T = predicted_T(truth, from_there) - predicted_T(truth, readings)
    said, outcome = said_of(rig, readings.with_field(readings.field_sensor_T + moved_T))
    (scattering,) = said.given
    told = {scattering.cause, *(other.cause for other in scattering.alternatives)}
    assert {JITTER} <= told <= {JITTER, GROWS}  # noise that grows with the field may be its twin
    if scattering.cause == JITTER:
        sd_m = float(said.answer.plain.values["position_jitter[arm1].sd_m"])
        assert sd_m == pytest.approx(6e-4, rel=0.25)
    assert [named.cause for named in outcome.named] == [scattering.cause]
    assert outcome.verdict in (Verdict.NAMED, Verdict.INDISTINGUISHABLE)


def test_a_burst_is_unexplained(rig, readings):
    """Outliers lie anywhere; these all in a tenth of the session."""
    n = len(readings)
    row = torch.argsort(torch.argsort(readings.time_s))
    during = (row >= n // 2) & (row < n // 2 + n // 10)
    _, outcome = said_of(rig, wild(readings, during[:, None].expand(-1, 3)))
    assert outcome.scatter.is_probable
    assert "time" in outcome.scatter.along
    assert outcome.verdict.leaves_something


def test_even_noise_has_no_cause_of_scatter(rig, readings):
    said, outcome = said_of(rig, readings)
    assert said.given == ()
    assert outcome.verdict is Verdict.NOTHING_FOUND


def test_causes_of_scatter_that_explain_it_as_well_are_alternatives(rig, readings):
    """Shares of evidence among them, beside that nothing scatters."""
    fit = fit_of(rig, readings)
    named = _named([(OUTLIERS, 8.0, fit), (JITTER, 7.0, fit), (OFFSET, 2.0, fit)], -4.0)
    weights = torch.tensor([4.0, 3.0, -2.0], dtype=torch.float64).exp()
    assert named.probability == pytest.approx(float(weights[0] / (1.0 + weights.sum())))
    (other,) = named.alternatives
    assert (other.cause, other.probability) == (
        JITTER,
        pytest.approx(float(weights[1] / (1.0 + weights.sum()))),
    )

"""Which cause a step takes where scatter and structure both explain the readings."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.hypotheses.step import Hypothesis, _choice
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.rig.rig import Cause


def of(name: str, log_bayes_factor: float) -> Hypothesis:
    return Hypothesis(Cause(name, "here"), name, log_bayes_factor)


@pytest.fixture
def quiet() -> Discrepancy:
    return Discrepancy(0.0, "position", {}, 0.0, torch.zeros(3, 1, dtype=torch.float64))


@pytest.mark.parametrize(
    ("scatter", "curve", "stands", "taken"),
    [
        (60.0, 0.0, False, "noise_grows"),
        (60.0, 0.0, True, "current_compression"),  # something is left of it beside the scatter
        (60.0, 55.0, False, "current_compression"),  # curves explain as much: there is structure
        (25.0, 0.0, False, "current_compression"),  # scatter imitates
        (15.0, 0.0, False, "current_compression"),
    ],
)
def test_scatter_that_imitates_structure_comes_first_only_where_it_leads_by_far(
    scatter: float, curve: float, stands: bool, taken: str, quiet: Discrepancy
) -> None:
    earning = [of("noise_grows", scatter), of("current_compression", 20.0)]
    earning.sort(key=lambda one: -one.log_bayes_factor)
    remainder = replace(quiet, log_bayes_factor=curve)
    choice = _choice(earning, remainder, lambda one, beside: stands)
    assert choice is not None
    assert choice.name == taken


def test_outliers_come_first_where_they_lead_and_a_lone_scatter_is_taken(quiet: Discrepancy) -> None:
    both = [of("outliers", 21.0), of("current_compression", 20.0)]
    assert _choice(both, quiet, lambda one, beside: True) is both[0]
    alone = [of("position_jitter", 10.0)]
    assert _choice(alone, quiet, lambda one, beside: True) is alone[0]
    assert _choice([], quiet, lambda one, beside: True) is None

"""Readings that miss the more at some times or after some moves are noticed, though no curve shows it; even noise and even wild readings pass."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.scatter import scatter_of
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.sessions import plain_fit

pytestmark = pytest.mark.whole
OUTLIERS = Cause("outliers", "hall")
NOISE_T = 2e-5


def with_more(widths: Tensor, cause: Cause | None = None) -> Fit:
    """The plain session with normal scatter on top, so many times the noise at each reading, fitted with a cause of scatter or none."""
    base = plain_fit()
    generator = torch.Generator().manual_seed(5)
    more = torch.randn(len(base.observations), 3, generator=generator, dtype=torch.float64)
    readings = base.observations.with_field(
        base.observations.field_sensor_T + NOISE_T * widths[:, None] * more
    )
    rig = base.rig if cause is None else with_effect(base.rig, cause, readings, {"share": 0.08, "ratio": 6.0})
    return fit_rig(rig, readings, base.start_with(rig), base.posterior.model.rules)


def in_a_burst(n: int) -> Tensor:
    """Wild for a tenth of the session."""
    reading = torch.arange(n)
    return 6.0 * ((reading >= n // 2) & (reading < n // 2 + n // 10)).to(torch.float64)


def here_and_there(n: int) -> Tensor:
    """As many wild readings at random."""
    chosen = torch.randperm(n, generator=torch.Generator().manual_seed(1))[: n // 10]
    return 6.0 * torch.zeros(n, dtype=torch.float64).index_fill(0, chosen, 1.0)


def test_even_noise_leaves_nothing():
    n = len(plain_fit().observations)
    assert not scatter_of(with_more(torch.ones(n, dtype=torch.float64))).is_probable


def test_a_burst_and_growing_noise_are_noticed():
    n = len(plain_fit().observations)
    burst = scatter_of(with_more(in_a_burst(n)))
    growing = scatter_of(with_more(4.0 * torch.linspace(0.0, 1.0, n, dtype=torch.float64) ** 3))
    assert burst.is_probable
    assert growing.is_probable
    assert "time" in burst.along


def test_readings_that_are_wild_anywhere_leave_nothing_beside_outliers_and_a_burst_does():
    n = len(plain_fit().observations)
    anywhere, burst = (with_more(widths, OUTLIERS) for widths in (here_and_there(n), in_a_burst(n)))
    assert not scatter_of(anywhere).is_probable
    assert scatter_of(burst).is_probable

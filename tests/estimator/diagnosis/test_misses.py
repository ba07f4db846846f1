"""What is said of how far the rig as described misses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements import gain

pytestmark = pytest.mark.whole


@pytest.mark.parametrize(("rms_T", "has_most"), [(3e-5, False), (9e-5, True)])
def test_a_component_is_told_only_where_more_than_noise_is_missed(monkeypatch, rms_T, has_most):
    """Below the noise the sensor with the most noise would be told, whatever is wrong."""
    monkeypatch.setattr(gain, "_mostly", lambda _: ", mostly in y of hall")
    lack = SimpleNamespace(lack_of_fit=SimpleNamespace(rms_T=rms_T, noise_T=5e-5, noise_from="rig"))
    diagnosis: Any = SimpleNamespace(fits=SimpleNamespace(before=lack, after=lack), improvement=None)
    told = gain.misses(cast(Diagnosis, diagnosis))
    assert (", mostly in y of hall" in told) == has_most
    assert ("but not at random" in told) != has_most

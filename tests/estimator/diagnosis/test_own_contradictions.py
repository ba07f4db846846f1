"""What a diagnosis brings about by itself is never said to be bad input."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimator.diagnosis import diagnose as module
from estimator.diagnosis import posterior
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.headline import warnings_of
from estimator.diagnosis.limits import Limits
from estimator.errors import InvalidInput

pytestmark = pytest.mark.whole
RULE = "effects must shift the rows of a record once"


def refuse(*_: object, **__: object) -> None:
    raise InvalidInput(RULE)


def test_a_combination_that_no_rig_can_have_is_a_fault_of_the_program(small_session, monkeypatch):
    monkeypatch.setattr(module, "asked_beside_mistakes", refuse)
    with pytest.raises(RuntimeError, match=RULE) as caught:
        diagnose(small_session)
    assert not isinstance(caught.value, InvalidInput)
    assert isinstance(caught.value.__cause__, InvalidInput)


def test_input_that_cannot_be_fitted_is_still_refused(small_session, small_rig):
    nothing_free = small_rig.with_fixed(parameter.name for parameter in small_rig.free)
    with pytest.raises(InvalidInput, match="at least one free parameter"):
        diagnose(small_session, nothing_free)


def test_a_rig_that_cannot_be_sampled_costs_the_posterior_and_not_the_report(small_session, monkeypatch):
    found = diagnose(small_session, limits=Limits(most_causes=0))
    monkeypatch.setattr(posterior, "extended_posterior", refuse)
    result = posterior.with_posterior(found, small_session, Limits(), None, "cpu", "double")
    assert result == replace(found, posterior_refusal=RULE)
    assert any(RULE in words for words in warnings_of(result))
    assert found.posterior_refusal == ""
    assert not any(RULE in words for words in warnings_of(found))

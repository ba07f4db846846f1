"""A diagnosis on another device: columns, evidences, corrections and names are those of the processor, and none of its tensors slips in."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch.testing import assert_close

from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.elsewhere import computed_on
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.climb import ask
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.items import Dictionary
from estimator.diagnosis.result import Diagnosis
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong
from tests.far import far_device

pytestmark = pytest.mark.whole

GAIN = Cause("axis_gain", "hall")


@pytest.fixture(scope="module")
def plain(small_rig: Rig, small_session: Session) -> Fit:
    """Without a cause that is there."""
    return fit_of(small_rig, with_wrong(small_rig, small_session.observations, GAIN, {"x": 0.06}))


@dataclass(frozen=True)
class Weighed:
    """What the readings say at a fit, item by item."""

    pool: tuple[Candidate, ...]
    dictionary: Dictionary
    alone: torch.Tensor
    leading: tuple[int, ...]
    beside: torch.Tensor


def weighed(fit: Fit) -> Weighed:
    asked = ask(Expansion.of(fit), Limits(), 1, {})
    products = asked.slots.products
    alone, beside = products.beside([], asked.noise), products.beside(asked.leading, asked.noise)
    return Weighed(asked.pool, asked.dictionary, alone, asked.leading, beside)


def assert_alike(there: Weighed, near: Weighed) -> None:
    assert [(c.cause, c.keys) for c in there.pool] == [(c.cause, c.keys) for c in near.pool]
    for far, here in zip(there.pool, near.pool, strict=True):
        assert far.shapes == pytest.approx(here.shapes, rel=1e-12)
        assert (far.columns.device.type, far.columns.dtype) == ("cpu", torch.float64)
        assert_close(far.columns * far.prior_sd, here.columns * here.prior_sd, rtol=1e-6, atol=1e-6)
    assert there.dictionary.columns.device.type == "cpu"
    items = near.dictionary.items
    assert [(item.name, item.keys) for item in there.dictionary.items] == [(i.name, i.keys) for i in items]
    assert {item.is_listed for item in items} == {True, False}
    assert_close(there.alone, near.alone, rtol=1e-5, atol=1e-5)
    assert there.leading == near.leading
    assert {items[i].cause for i in near.leading} == {GAIN}
    assert_close(there.beside, near.beside, rtol=1e-5, atol=1e-5)


def test_items_on_another_device_say_the_same(plain):
    near = weighed(plain)
    with far_device() as far:
        assert_alike(computed_on(far, weighed, plain), near)


@pytest.mark.slow
def test_diagnosis_on_another_device_has_the_same_names(plain, small_rig, small_session, tmp_path):
    session = Session(small_rig, plain.observations, small_session.source)

    def evidence(found: Diagnosis) -> list[dict[str, float]]:
        return [{h.name: h.log_bayes_factor for h in c.hypotheses} for _, c in found.comparisons]

    near = diagnose(session, seed=1)
    assert near.findings.causes
    with far_device() as far:
        there = diagnose(session, seed=1, device=str(far), out=tmp_path)
    assert there.verdict == near.verdict
    assert there.left_open.twins == near.left_open.twins
    assert len(evidence(there)) == len(evidence(near)) > 1
    for after, before in zip(evidence(there), evidence(near), strict=True):
        assert after == pytest.approx(before, abs=1e-3)
    for named, same in zip(there.findings.causes, near.findings.causes, strict=True):
        assert named.cause == same.cause
        assert named.probability == pytest.approx(same.probability, abs=1e-3)
    assert (tmp_path / "diagnosis.json").exists()

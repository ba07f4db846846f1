"""A diagnosis on another device: columns, evidences, curves, corrections and names are those of the processor, and none of its tensors slips in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.elsewhere import computed_on
from estimator.diagnosis.fit_place import climbing_on
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.hypotheses.pairs import pairs
from estimator.diagnosis.hypotheses.screening import in_full, screening
from estimator.diagnosis.hypotheses.several_places import joint_evidence
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.structure.cross_validation import log_predictive
from estimator.diagnosis.structure.discrepancy import Discrepancy, discrepancy
from estimator.diagnosis.structure.families import families
from estimator.readings.split import pose_blocks
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import corrected, fit_of, with_wrong
from tests.far import far_device

pytestmark = pytest.mark.whole

GAIN = Cause("axis_gain", "hall")


@pytest.fixture(scope="module")
def plain(small_rig: Rig, small_session: Session) -> Fit:
    """Without a cause that is there."""
    return fit_of(small_rig, with_wrong(small_rig, small_session.observations, GAIN, {"x": 0.04}))


@dataclass(frozen=True)
class Screened:
    """What the search asks at a fit before it fits any cause."""

    pool: list[Candidate]
    evidence: dict[Cause, tuple[float, float, Candidate]]
    curves: Discrepancy
    pairs: list[tuple[float, Candidate, Candidate]]
    together: float
    blocks: torch.Tensor


def screened(fit: Fit) -> Screened:
    pool = candidates(fit, causes_of(fit.rig, fit))
    evidence = screening(fit, pool)
    of_two = [start for cause, (_, _, start) in evidence.items() if cause.name.startswith("sensor_")]
    starts = [start for start in of_two if start.is_at_null]
    return Screened(
        pool,
        evidence,
        discrepancy(fit, families(fit)),
        pairs(fit, pool, 0.0),
        joint_evidence(fit, starts)[0],
        log_predictive(fit, pose_blocks(fit.observations, np.random.default_rng(0))),
    )


def assert_alike(there: Screened, near: Screened) -> None:
    assert [(c.cause, c.keys) for c in there.pool] == [(c.cause, c.keys) for c in near.pool]
    for far, here in zip(there.pool, near.pool, strict=True):
        assert far.shapes == pytest.approx(here.shapes, rel=1e-12)
        assert (far.columns.device.type, far.columns.dtype) == ("cpu", torch.float64)
        assert_close(far.columns * far.prior_sd, here.columns * here.prior_sd, rtol=1e-6, atol=1e-6)
    best_there, best_near = (max(e, key=lambda cause: e[cause][0]) for e in (there.evidence, near.evidence))
    assert best_there == best_near
    assert near.evidence[GAIN][0] > 10.0
    for cause, (value, highest, start) in near.evidence.items():
        assert there.evidence[cause][:2] == pytest.approx((value, highest), rel=1e-6, abs=1e-6)
        assert there.evidence[cause][2].shapes == pytest.approx(start.shapes, rel=1e-12)
    assert there.curves.by_family == pytest.approx(near.curves.by_family, rel=1e-6, abs=1e-6)
    assert there.curves.family == near.curves.family
    assert [pair[0] for pair in there.pairs] == pytest.approx(
        [pair[0] for pair in near.pairs], rel=1e-6, abs=1e-6
    )
    assert len(near.pairs) > 1
    assert there.together == pytest.approx(near.together, rel=1e-6)
    assert_close(there.blocks, near.blocks, rtol=1e-6, atol=1e-6)


def test_screening_on_another_device_says_the_same(plain: Fit) -> None:
    near = screened(plain)
    with far_device() as far:
        assert_alike(computed_on(far, screened, plain), near)


def test_screening_does_not_depend_on_the_precision_of_new_tensors(plain: Fit) -> None:
    """torch makes tensors in a default precision, single where nobody says otherwise."""
    assert torch.get_default_dtype() is torch.float32
    in_single = screened(plain)
    torch.set_default_dtype(torch.float64)
    try:
        in_double = screened(plain)
    finally:
        torch.set_default_dtype(torch.float32)
    assert_alike(in_single, in_double)


def test_full_fit_of_a_cause_there_climbs_in_single_precision_and_ends_in_double(plain: Fit) -> None:
    start = screening(plain, candidates(plain, [GAIN]))[GAIN]

    def fitted(fit: Fit) -> tuple[float, Fit]:
        (value, _, candidate), *_ = screening(fit, candidates(fit, [GAIN])).values()
        return in_full(fit, value, candidate)

    near_value, near = in_full(plain, start[0], start[2])
    with far_device() as far:
        for dtype in (torch.float64, torch.float32):
            with climbing_on(far, dtype):
                value, there = computed_on(far, fitted, plain)
            assert value == pytest.approx(near_value, abs=1e-3)
            assert there.observations is plain.observations
            assert there.vector.dtype == torch.float64
            assert float(((there.vector - near.vector) ** 2 / near.covariance.diagonal()).max()) < 1e-4


def test_on_the_processor_nothing_is_moved(plain: Fit) -> None:
    asked: list[Fit] = []
    assert computed_on(torch.device("cpu"), lambda fit: asked.append(fit) or fit, plain) is plain
    assert asked == [plain]


@pytest.mark.slow
def test_correction_on_another_device_is_the_same(plain: Fit) -> None:
    near = corrected(plain)
    assert near.parts
    with far_device() as far:
        there = computed_on(far, corrected, plain)
    assert [(part.cause, part.degree) for part in there.parts] == [(p.cause, p.degree) for p in near.parts]
    assert there.refusal == near.refusal
    assert there.fit.log_evidence == pytest.approx(near.fit.log_evidence, abs=1e-3)


@pytest.mark.slow
def test_diagnosis_on_another_device_has_the_same_names(
    plain: Fit, small_rig: Rig, small_session: Session, tmp_path: Path
) -> None:
    session = Session(small_rig, plain.observations, small_session.source)

    def evidence(found: Diagnosis) -> list[dict[str, float]]:
        return [{h.name: h.log_bayes_factor for h in step.hypotheses} for step in found.findings.search.steps]

    near = diagnose(session)
    assert near.findings.causes
    with far_device() as far:
        there = diagnose(session, device=str(far), out=tmp_path)
    assert there.verdict == near.verdict
    assert there.left_open.twins == near.left_open.twins
    assert len(evidence(there)) == len(evidence(near))
    for after, before in zip(evidence(there), evidence(near), strict=True):
        assert after == pytest.approx(before, abs=1e-3)
    for named, same in zip(there.findings.causes, near.findings.causes, strict=True):
        assert named.cause == same.cause
        assert named.probability == pytest.approx(same.probability, abs=1e-4)
    assert (tmp_path / "diagnosis.json").exists()

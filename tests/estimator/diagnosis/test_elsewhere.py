"""A diagnosis on another device: columns, evidences, corrections and names are those of the processor, and none of its tensors slips in."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.elsewhere import computed_on
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.correcting import corrected
from estimator.diagnosis.result import Diagnosis
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import answered, fit_of, with_wrong
from tests.far import far_device

pytestmark = pytest.mark.whole

GAIN = Cause("axis_gain", "hall")


@pytest.fixture(scope="module")
def plain(small_rig: Rig, small_session: Session) -> Fit:
    """Without a cause that is there."""
    return fit_of(small_rig, with_wrong(small_rig, small_session.observations, GAIN, {"x": 0.06}))


@pytest.mark.slow
def test_correction_on_another_device_is_the_same(of_dipole: Answer) -> None:
    def corrected_there(fit: Fit) -> Correction:
        found = answered(fit)
        return corrected(found, found.plain, found.plain, Limits())

    near = corrected(of_dipole, of_dipole.plain, of_dipole.plain, Limits())
    assert near.parts
    with far_device() as far:
        there = computed_on(far, corrected_there, of_dipole.plain)
    assert [(part.cause, part.degree) for part in there.parts] == [(p.cause, p.degree) for p in near.parts]
    assert there.refusal == near.refusal
    assert there.fit.log_evidence == pytest.approx(near.fit.log_evidence, abs=1e-3)


@pytest.mark.slow
def test_diagnosis_on_another_device_has_the_same_names(
    plain: Fit, small_rig: Rig, small_session: Session, tmp_path: Path
) -> None:
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

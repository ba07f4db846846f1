"""The conclusion on one new session beside the current calibration, and the calibration that would replace it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch

from estimator.calibration.result import Calibration
from estimator.diagnosis import policy as diagnosis_policy
from estimator.diagnosis.diagnose import diagnose
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.model.preflight import check_readings
from estimator.model.unit_gate import check_units
from estimator.readings.split import with_validation
from estimator.recalibration.comparison import Comparison
from estimator.recalibration.conclusion import IS_CONVERGED, Conclusion, Judgement, mistake_in, names_of
from estimator.recalibration.successor import (
    causes_of,
    estimate_of,
    is_unexplained,
    sampled_successor,
    short_of,
)
from estimator.recalibration.watcher import UNWATCHED, Watcher
from estimator.recalibration.widening import widened_rig
from estimator.rig.rig import Rig
from estimator.store.session import Session


def judge(
    session: Session,
    rig: Rig,
    current: Calibration | None,
    *,
    earlier: Sequence[Mapping[str, float]] = (),
    may_replace: bool = True,
    seed: int = 0,
    settings: SamplerSettings | None = None,
    watcher: Watcher = UNWATCHED,
) -> Judgement:
    """Conclude on one session.

    Args:
        session: The new readings. Those marked as validation judge a successor; if none is marked, a fifth is kept out in blocks.
        rig: Rig as the user describes it.
        current: The calibration in use; None before the first.
        earlier: Log Bayes factors of the preceding sessions that disagreed with the current version and led to no new one.
        may_replace: False for readings older than those of the version in use: they are judged but lead to no new version.
        seed: Seed of all random numbers.
        settings: When to stop sampling a successor.
        watcher: Gets the progress.
    Raises:
        InvalidInput: The rig or the current calibration cannot be used. Faults of the session do not raise: they lead to a rejection.
    """
    widened = None if current is None else widened_rig(current, rig)
    try:
        session.check_rig(rig)
        check_readings(rig, session.observations, session.source)
        check_units(rig, session.observations.calibration, session.source)
        readings = with_validation(session.observations, diagnosis_policy.VALIDATION_SHARE, seed)
        session = replace(session, observations=readings)
        if current is None or widened is None:
            return _first(session, rig, seed, settings, watcher)
        watcher.on_words("comparing with the current version")
        return Comparison.of(session, widened, current, seed, watcher).judgement(
            settings, earlier, may_replace
        )
    except (InvalidInput, torch.linalg.LinAlgError) as error:  # type: ignore[attr-defined]
        return Judgement(Conclusion.REJECTED, f"the readings cannot be used: {error}")


def _first(
    session: Session, rig: Rig, seed: int, settings: SamplerSettings | None, watcher: Watcher
) -> Judgement:
    diagnosis = diagnose(session, rig, seed=seed, on_stage=watcher.on_words, on_progress=watcher.on_progress)
    if diagnosis.is_record_wrong:
        return Judgement(Conclusion.REJECTED, mistake_in(diagnosis), causes=causes_of(diagnosis))
    calibration = sampled_successor(session, diagnosis, seed, settings, watcher)
    named = f", with {names_of(diagnosis)} in the rig" if diagnosis.causes else ""
    left = "; structure is left that no known cause explains" if is_unexplained(diagnosis) else ""
    unsure = (
        ""
        if calibration.summary()["is_converged"]
        else f"; {short_of(calibration)}, intervals are provisional"
    )
    return Judgement(
        Conclusion.UPDATED,
        f"first calibration{named}{left}{unsure}",
        calibration,
        causes=causes_of(diagnosis),
        checks={"verdict": str(diagnosis.verdict), IS_CONVERGED: calibration.summary()["is_converged"]},
        estimate=estimate_of(diagnosis.fits.final),
    )

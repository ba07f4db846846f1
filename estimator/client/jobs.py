"""Jobs of the service by their kinds: what each is asked with, and what is made of its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from estimator.client.calibrations import summary_of
from estimator.client.following import Tell, result_of
from estimator.client.steps import Steps
from estimator.client.uploads import upload, upload_rig
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.registry import Entry
from estimator.rig.rig import Rig
from estimator.store.session import Session

Summary = tuple[str, dict[str, Any]]


def calibrate(
    session: Session,
    rig: Rig | None,
    options: Mapping[str, Any],
    settings: SamplerSettings | None,
    tell: Tell | None,
) -> Steps[Summary]:
    """Id and summary of the calibration that is made."""
    body = {"settings": _sampling(settings), **options}
    result = yield from _of_session("calibrate", session, rig, body, tell)
    return str(result["calibration_id"]), result["result"]


def diagnose(
    session: Session, rig: Rig | None, options: Mapping[str, Any], tell: Tell | None
) -> Steps[tuple[dict[str, Any], str, Summary | None]]:
    """`diagnosis.json`, the text of the extended rig, and id and summary of its calibration where there is one."""
    result = yield from _of_session("diagnose", session, rig, options, tell)
    made = result["calibration_id"]
    posterior = None if made is None else (yield from summary_of(str(made)))
    return result["result"], result["extended_rig"], posterior


def recalibrate(
    session: Session, rig: Rig | None, seed: int, settings: SamplerSettings | None, tell: Tell | None
) -> Steps[Entry]:
    """The entry of the registry's log."""
    body = {"seed": seed, "settings": _sampling(settings)}
    result = yield from _of_session("recalibrate", session, rig, body, tell)
    return Entry(**result["result"])


def design(
    session: Session, rig: Rig | None, aim: Mapping[str, Any], tell: Tell | None
) -> Steps[dict[str, Any]]:
    """What `coilcal design --json` prints, with the text of the plan."""
    result = yield from _of_session("design", session, rig, aim, tell)
    return dict(result["result"])


def batch(
    sessions: Sequence[Session],
    rig: Rig | None,
    options: Mapping[str, Any],
    settings: SamplerSettings | None,
    tell: Tell | None,
) -> Steps[dict[str, Any]]:
    """Rows of the fits, and reasons of failures."""
    session_ids = []
    for session in sessions:
        session_ids.append((yield from upload(session)))
    rig_id = None if rig is None else (yield from upload_rig(rig))
    body = {"session_ids": session_ids, "rig_id": rig_id, "settings": _sampling(settings), **options}
    result = yield from result_of("batch", body, tell)
    return dict(result["result"])


def _of_session(
    kind: str, session: Session, rig: Rig | None, options: Mapping[str, Any], tell: Tell | None
) -> Steps[dict[str, Any]]:
    rig_id = None if rig is None else (yield from upload_rig(rig))
    session_id = yield from upload(session)
    return (yield from result_of(kind, {"session_id": session_id, "rig_id": rig_id, **options}, tell))


def _sampling(settings: SamplerSettings | None) -> dict[str, Any]:
    """Settings as the service takes them: the seed stands beside."""
    wanted = asdict(settings or SamplerSettings())
    wanted.pop("seed")
    return wanted

"""The periodic job: new sessions from an inbox, a conclusion on each, and the registry of calibrations they lead to."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from estimator.calibration import write_text
from estimator.errors import CoilcalError, InvalidInput
from estimator.history_report import history_report
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.judgement import EVIDENCE, Conclusion, Judgement, judge
from estimator.registry import Entry, Registry
from estimator.rig import Rig
from estimator.store.session import Session, load_session

HISTORY = "history.html"


def recalibrate(
    rig: Rig,
    inbox: Path | str,
    registry: Path | str,
    *,
    seed: int = 0,
    settings: SamplerSettings | None = None,
    on_entry: Callable[[Entry], None] | None = None,
) -> list[Entry]:
    """Judge every new session of an inbox, oldest readings first, and keep the calibrations they lead to.

    A session that is in the log is skipped, so the same call again does nothing; one that was interrupted goes on.

    Args:
        rig: As the user describes it, with the priors of the beginning.
        inbox: Folder with sessions, `*.zarr`; nothing in it is changed.
        registry: Folder for versions, log and `history.html`; made where it is missing.
        seed: Of everything random.
        settings: When to stop sampling a new version.
        on_entry: Told of each conclusion once it is logged.
    Returns: The lines that were added to the log.
    Raises:
        InvalidInput: The inbox is no folder, another job holds the registry, or it is of another rig.
        CorruptStore: The log or the current version is damaged.
    """
    inbox, kept = Path(inbox), Registry(registry)
    if not inbox.is_dir():
        raise InvalidInput(f"inbox must be a folder of sessions; received {inbox}")
    if not rig.free:
        raise InvalidInput(f"rig must have at least one free parameter (a prior); rig {rig.name!r} has none")
    added = []
    with kept.writing():
        if kept.current is not None:
            _check_same(rig, kept.calibration().rig, kept.folder)
        done = {entry.hash for entry in kept.entries()}
        for arrival in _arrivals(inbox):
            if arrival.hash in done:
                continue
            done.add(arrival.hash)
            entry = _concluded(arrival, rig, kept, seed, settings)
            added.append(entry)
            if on_entry is not None:
                on_entry(entry)
        if kept.entries():
            write_text(kept.folder / HISTORY, history_report(kept))
    return added


def roll_back(registry: Path | str, version: int) -> Entry:
    """Make an earlier version of a registry current again.

    Raises:
        InvalidInput: There is no such registry or version, or another job holds it.
        CorruptStore: The version is damaged.
    """
    kept = Registry(registry)
    if not kept.versions:
        raise InvalidInput(
            f"registry must be a folder that coilcal recalibrate has filled; received {registry}"
        )
    with kept.writing():
        entry = kept.roll_back(version)
        write_text(kept.folder / HISTORY, history_report(kept))
    return entry


@dataclass(frozen=True)
class _Arrival:
    """One session of the inbox; `fault` says why it cannot be read."""

    path: Path
    taken: str
    hash: str
    fault: str = ""


def _arrivals(inbox: Path) -> list[_Arrival]:
    """All sessions of the inbox, oldest readings first."""
    found = []
    for path in sorted(inbox.glob("*.zarr")):
        try:
            session = load_session(path)
            found.append(_Arrival(path, _utc(datetime.fromisoformat(session.created)), session.hash))
        except (CoilcalError, ValueError) as error:
            changed = datetime.fromtimestamp(path.stat().st_mtime, UTC)
            found.append(_Arrival(path, _utc(changed), _hash_of_files(path), str(error)))
    return sorted(found, key=lambda arrival: arrival.taken)


def _check_same(rig: Rig, current: Rig, folder: Path) -> None:
    """Refuse the rig file of another rig, for which every session would be bad data."""
    described, kept = (
        [one.name for one in r.coils] + [one.name for one in r.sensors] + [one.name for one in r.movers]
        for r in (rig, current)
    )
    if described != kept:
        raise InvalidInput(
            f"rig must name the coils, sensors and movers of the registry ({', '.join(kept)}); received {', '.join(described)} ({folder})"
        )


def _utc(time: datetime) -> str:
    """In one time zone, so that the text sorts; a time without a zone is that of the room."""
    return time.astimezone(UTC).isoformat(timespec="seconds")


def _hash_of_files(folder: Path) -> str:
    result = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        result.update(str(path.relative_to(folder)).encode())
        result.update(path.read_bytes() if path.is_file() else b"")
    return result.hexdigest()


def _concluded(
    arrival: _Arrival, rig: Rig, kept: Registry, seed: int, settings: SamplerSettings | None
) -> Entry:
    judgement = _judged(arrival, rig, kept, seed, settings)
    is_drift = judgement.conclusion is Conclusion.DRIFTED
    entry = Entry(
        str(judgement.conclusion),
        judgement.reason,
        str(arrival.path),
        arrival.hash,
        arrival.taken,
        agrees=judgement.agrees,
        causes=judgement.causes,
        since=_since(kept.entries(), arrival.taken) if is_drift else None,
        checks=judgement.checks,
        estimate=judgement.estimate,
    )
    return kept.commit(entry, judgement.calibration)


def _judged(
    arrival: _Arrival, rig: Rig, kept: Registry, seed: int, settings: SamplerSettings | None
) -> Judgement:
    if arrival.fault:
        return Judgement(Conclusion.REJECTED, f"the session cannot be read: {arrival.fault}")
    session: Session = load_session(arrival.path)
    current = None if kept.current is None else kept.calibration()
    earlier = [entry.checks[EVIDENCE] for entry in _disagreeing(kept.entries()) if EVIDENCE in entry.checks]
    return judge(session, rig, current, earlier=earlier, seed=seed, settings=settings)


def _since(entries: list[Entry], taken: str) -> str:
    """Time of the first session in a row that disagreed and led to no new version, this one included."""
    return next((entry.taken for entry in reversed(_disagreeing(entries))), taken)


def _disagreeing(entries: list[Entry]) -> list[Entry]:
    """The last sessions in a row that disagreed and led to no new version, the latest first; others that could not be asked lie between."""
    found = []
    for entry in reversed(entries):
        was_asked = entry.agrees is not None or entry.made is not None or not entry.hash
        if was_asked and (entry.agrees is not False or entry.made is not None):
            break
        if was_asked:
            found.append(entry)
    return found

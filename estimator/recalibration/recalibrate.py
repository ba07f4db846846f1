"""The periodic job: new sessions from an inbox, a conclusion on each, and the registry of calibrations they lead to."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from estimator.calibration.result import write_text
from estimator.code_version import code_version
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.arrivals import CHANGED, Arrival, arrivals
from estimator.recalibration.history_report import history_report
from estimator.recalibration.judgement import EVIDENCE, Conclusion, Judgement, judge
from estimator.recalibration.registry import Entry, Registry
from estimator.rig.rig import Rig

HISTORY = "history.html"
LATE = "compared_with_version"  # among the checks of a session older than the current version


def recalibrate(
    rig: Rig,
    inbox: Path | str,
    registry: Path | str,
    *,
    seed: int = 0,
    settings: SamplerSettings | None = None,
    again: Collection[str] = (),
    on_entry: Callable[[Entry], None] | None = None,
    on_waiting: Callable[[Path, str], None] | None = None,
) -> list[Entry]:
    """Judge every new session of an inbox, oldest readings first, and keep the calibrations they lead to.

    A session that is in the log is skipped, so the same call again does nothing; one that was interrupted goes on. A session that is
    still being measured or copied is left for the next time.

    Args:
        rig: As the user describes it, with the priors of the beginning.
        inbox: Folder with sessions, `*.zarr`; nothing in it is changed.
        registry: Folder for versions, log and `history.html`; made where it is missing.
        seed: Of everything random.
        settings: When to stop sampling a new version.
        again: Names of sessions in the inbox that are judged once more although they are in the log.
        on_entry: Told of each conclusion once it is logged; of one that an interrupted call could not tell, by the next call.
        on_waiting: Told of each session that is left for the next time, and why.
    Returns: The lines of the log that were told.
    Raises:
        InvalidInput: The inbox is no folder, another job holds the registry, or it is of another rig.
        CorruptStore: The log or the current version is damaged.
    """
    inbox, kept = Path(inbox), Registry(registry)
    if not inbox.is_dir():
        raise InvalidInput(f"inbox must be a folder of sessions; received {inbox}")
    if not rig.free:
        raise InvalidInput(f"rig must have at least one free parameter (a prior); rig {rig.name!r} has none")
    chosen = settings or SamplerSettings()
    chosen.for_rig(len(rig.free))  # too few walkers are a fault of the call, not of a session
    hear, wait = on_entry or (lambda entry: None), on_waiting or (lambda path, why: None)
    with kept.writing():
        if kept.current is not None:
            _check_same(rig, kept.calibration().rig, kept.folder)
        told = kept.tell(hear)
        found, waiting = arrivals(inbox)
        _check_there(again, [*(arrival.path for arrival in found), *waiting])
        done = {entry.hash for entry in kept.entries()}
        done -= {arrival.hash for arrival in found if arrival.path.name in again}
        for arrival in found:
            if arrival.hash in done:
                continue
            done.add(arrival.hash)
            if _concluded(arrival, rig, kept, seed, chosen):
                told += kept.tell(hear)
            else:
                waiting[arrival.path] = CHANGED
        if kept.entries():
            write_text(kept.folder / HISTORY, history_report(kept))
    for path, why in waiting.items():
        wait(path, why)
    return told


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


def _check_there(names: Collection[str], paths: list[Path]) -> None:
    for name in names:
        if name not in {path.name for path in paths}:
            raise InvalidInput(f"a session to be judged again must lie in the inbox; received {name!r}")


def _concluded(arrival: Arrival, rig: Rig, kept: Registry, seed: int, settings: SamplerSettings) -> bool:
    """Judge one session and log what it amounts to. Whether it could be: it may have changed since it was found."""
    judgement = Judgement(Conclusion.REJECTED, f"the session cannot be read: {arrival.fault}")
    entries = kept.entries()
    beside = None if arrival.fault else _in_use(entries, kept.current, arrival.taken)
    is_late = beside is not None and not _is_as_young(entries, kept.current, arrival.taken)
    if not arrival.fault:
        session = arrival.session()
        if session is None:
            return False
        judgement = judge(
            session,
            rig,
            None if beside is None else kept.calibration(beside),
            earlier=() if is_late else _evidence(entries),
            may_replace=not is_late,
            seed=seed,
            settings=settings,
        )
    is_drift = judgement.conclusion is Conclusion.DRIFTED
    since = (arrival.taken if is_late else _since(entries, arrival.taken)) if is_drift else None
    late = f"comes late: its readings are older than those of version {kept.current}, which stays; beside version {beside}: "
    entry = Entry(
        str(judgement.conclusion),
        (late if is_late else "") + judgement.reason,
        str(arrival.path),
        arrival.hash,
        arrival.taken,
        agrees=judgement.agrees,
        causes=judgement.causes,
        since=since,
        checks={**judgement.checks, **({LATE: beside} if is_late else {})},
        estimate=judgement.estimate,
    )
    provenance = {
        "described_rig_hash": rig.hash,
        "settings": asdict(replace(settings, seed=seed)),
        "code": code_version(),
    }
    kept.commit(entry, judgement.calibration, provenance)
    return True


def _taken(entries: Sequence[Entry]) -> dict[int, str]:
    """Time of the readings of each version."""
    return {entry.made: entry.taken for entry in entries if entry.made is not None}


def _is_as_young(entries: Sequence[Entry], current: int | None, taken: str) -> bool:
    """Whether readings may replace the current version: those of an earlier time say nothing of the present."""
    return current is None or taken >= _taken(entries)[current]


def _in_use(entries: Sequence[Entry], current: int | None, taken: str) -> int | None:
    """The version that readings are compared with: the current one; for older readings the last one before them, or the first of all."""
    if _is_as_young(entries, current, taken):
        return current
    of = _taken(entries)
    before = [version for version in of if of[version] <= taken]
    return max(before, key=lambda v: (of[v], v)) if before else min(of, key=lambda v: (of[v], v))


def _since(entries: Sequence[Entry], taken: str) -> str:
    """Time of the first session in a row that disagreed and led to no new version, this one included."""
    return next((entry.taken for entry in reversed(_disagreeing(entries))), taken)


def _evidence(entries: Sequence[Entry]) -> list[Mapping[str, float]]:
    return [entry.checks[EVIDENCE] for entry in _disagreeing(entries) if EVIDENCE in entry.checks]


def _disagreeing(entries: Sequence[Entry]) -> list[Entry]:
    """The last sessions in a row that disagreed and led to no new version, the latest first.

    Others may lie between: some that could not be asked, that came late, or whose record holds a mistake.
    """
    found = []
    for entry in reversed(entries):
        was_asked = entry.agrees is not None or entry.made is not None or not entry.hash
        is_mistake = entry.conclusion == Conclusion.REJECTED and bool(entry.causes)
        if not was_asked or is_mistake or LATE in entry.checks:
            continue
        if entry.agrees is not False or entry.made is not None:
            break
        found.append(entry)
    return found

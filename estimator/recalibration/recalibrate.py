"""The periodic job: takes new sessions from an inbox, concludes on each, and keeps new calibrations in a registry."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from estimator.code_version import code_version
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.recalibration.arrivals import CHANGED, Arrival, arrivals
from estimator.recalibration.conclusion import EVIDENCE, Conclusion, Judgement
from estimator.recalibration.history_report import history_report
from estimator.recalibration.judgement import judge
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import HISTORY, Registry
from estimator.recalibration.watcher import UNWATCHED, Watcher
from estimator.rig.rig import Rig
from estimator.store.files import write_text

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
    watcher: Watcher = UNWATCHED,
) -> list[Entry]:
    """Judge every new session of an inbox, oldest readings first, and keep the calibrations they lead to.

    Sessions in the log are skipped, so a repeated call does nothing, and an interrupted call is continued by the next. A session that is
    still being measured or copied waits for the next call.

    Args:
        rig: Rig as the user describes it, with the first priors.
        inbox: Folder with sessions, `*.zarr`; nothing in it is changed.
        registry: Folder for versions, log and `history.html`; created if missing.
        seed: Seed of all random numbers.
        settings: When to stop sampling a new version.
        again: Names of sessions in the inbox to judge once more although they are in the log.
        on_entry: Called with each conclusion once it is logged, also with those that an interrupted call left pending.
        on_waiting: Called with each session that waits for the next call, and the reason.
        watcher: Gets the progress of each judgement.
    Returns: The log entries that `on_entry` was called with.
    Raises:
        InvalidInput: The inbox is not a folder, another job holds the registry, or the registry is of another rig.
        CorruptStore: The log or the current version is damaged.
    """
    inbox, calibrations = Path(inbox), Registry(registry)
    if not inbox.is_dir():
        raise InvalidInput(f"inbox must be a folder of sessions; received {inbox}")
    rig.check_free()
    chosen = settings or SamplerSettings()
    chosen.for_rig(len(rig.free))  # too few walkers are a fault of the call, not of a session
    notify, notify_waiting = on_entry or (lambda entry: None), on_waiting or (lambda path, why: None)
    with calibrations.writing():
        if calibrations.current is not None:
            _check_same_rig(rig, calibrations.calibration().rig, calibrations.folder)
        delivered = calibrations.tell(notify)
        arrived, waiting = arrivals(inbox)
        _check_in_inbox(again, [*(arrival.path for arrival in arrived), *waiting])
        concluded = {entry.hash for entry in calibrations.entries()}
        concluded -= {arrival.hash for arrival in arrived if arrival.path.name in again}
        new: dict[str, Arrival] = {}
        for arrival in arrived:
            if arrival.hash not in concluded:
                new.setdefault(arrival.hash, arrival)
        for n, arrival in enumerate(new.values(), start=1):
            watcher.on_words(f"judging {arrival.path.name}, session {n} of {len(new)}")
            if _conclude(arrival, rig, calibrations, seed, chosen, watcher):
                delivered += calibrations.tell(notify)
            else:
                waiting[arrival.path] = CHANGED
        if calibrations.entries():
            write_text(calibrations.folder / HISTORY, history_report(calibrations))
    for path, why in waiting.items():
        notify_waiting(path, why)
    return delivered


def roll_back(registry: Path | str, version: int) -> Entry:
    """Make an earlier version of a registry current again.

    Raises:
        InvalidInput: There is no such registry or version, or another job holds it.
        CorruptStore: The version is damaged.
    """
    calibrations = Registry(registry)
    if not calibrations.versions:
        raise InvalidInput(
            f"registry must be a folder that coilcal recalibrate has filled; received {registry}"
        )
    with calibrations.writing():
        entry = calibrations.roll_back(version)
        write_text(calibrations.folder / HISTORY, history_report(calibrations))
    return entry


def _check_same_rig(rig: Rig, current: Rig, folder: Path) -> None:
    """Refuse the file of another rig, under which every session would be rejected."""
    described, registered = _names(rig), _names(current)
    if described != registered:
        raise InvalidInput(
            f"rig must name the coils, sensors and movers of the registry ({', '.join(registered)}); "
            f"received {', '.join(described)} ({folder})"
        )


def _names(rig: Rig) -> list[str]:
    coils, sensors = [coil.name for coil in rig.coils], [sensor.name for sensor in rig.sensors]
    return coils + sensors + [mover.name for mover in rig.movers]


def _check_in_inbox(names: Collection[str], paths: list[Path]) -> None:
    for name in names:
        if name not in {path.name for path in paths}:
            raise InvalidInput(f"a session to be judged again must lie in the inbox; received {name!r}")


def _conclude(
    arrival: Arrival, rig: Rig, registry: Registry, seed: int, settings: SamplerSettings, watcher: Watcher
) -> bool:
    """Judge one session and log the conclusion; False if the session has changed since it was found."""
    judgement = Judgement(Conclusion.REJECTED, f"the session cannot be read: {arrival.fault}")
    entries = registry.entries()
    reference = None if arrival.fault else _in_use(entries, registry.current, arrival.taken)
    is_late = reference is not None and not _is_as_recent(entries, registry.current, arrival.taken)
    if not arrival.fault:
        session = arrival.session()
        if session is None:
            return False
        judgement = judge(
            session,
            rig,
            None if reference is None else registry.calibration(reference),
            earlier=() if is_late else _evidence(entries),
            may_replace=not is_late,
            seed=seed,
            settings=settings,
            watcher=watcher,
        )
    is_drift = judgement.conclusion is Conclusion.DRIFTED
    since = (arrival.taken if is_late else _since(entries, arrival.taken)) if is_drift else None
    late = f"comes late: its readings are older than those of version {registry.current}, which stays; compared with version {reference}: "
    entry = Entry(
        str(judgement.conclusion),
        (late if is_late else "") + judgement.reason,
        str(arrival.path),
        arrival.hash,
        arrival.taken,
        agrees=judgement.agrees,
        causes=judgement.causes,
        since=since,
        checks={**judgement.checks, **({LATE: reference} if is_late else {})},
        estimate=judgement.estimate,
    )
    provenance = {
        "described_rig_hash": rig.hash,
        "settings": asdict(replace(settings, seed=seed)),
        "code": code_version(),
    }
    registry.commit(entry, judgement.calibration, provenance)
    return True


def _taken(entries: Sequence[Entry]) -> dict[int, str]:
    """Time of the readings of each version."""
    return {entry.made: entry.taken for entry in entries if entry.made is not None}


def _is_as_recent(entries: Sequence[Entry], current: int | None, taken: str) -> bool:
    """Whether readings may replace the current version, which older readings may not."""
    return current is None or taken >= _taken(entries)[current]


def _in_use(entries: Sequence[Entry], current: int | None, taken: str) -> int | None:
    """The version to compare readings with: the current one, or for older readings the last before them, else the first of all."""
    if _is_as_recent(entries, current, taken):
        return current
    times = _taken(entries)
    before = [version for version in times if times[version] <= taken]
    choose = max if before else min
    return choose(before or times, key=lambda version: (times[version], version))


def _since(entries: Sequence[Entry], taken: str) -> str:
    """Time of the first of the disagreeing sessions in a row, up to the present one."""
    return next((entry.taken for entry in reversed(_disagreeing(entries))), taken)


def _evidence(entries: Sequence[Entry]) -> list[Mapping[str, float]]:
    return [entry.checks[EVIDENCE] for entry in _disagreeing(entries) if EVIDENCE in entry.checks]


def _disagreeing(entries: Sequence[Entry]) -> list[Entry]:
    """The last sessions in a row that disagreed and led to no new version, latest first.

    Sessions that could not be compared, came late or have a mistake in their record do not interrupt the row.
    """
    disagreeing = []
    for entry in reversed(entries):
        was_compared = entry.agrees is not None or entry.made is not None or not entry.hash
        is_mistake = entry.conclusion == Conclusion.REJECTED and bool(entry.causes)
        if not was_compared or is_mistake or LATE in entry.checks:
            continue
        if entry.agrees is not False or entry.made is not None:
            break
        disagreeing.append(entry)
    return disagreeing

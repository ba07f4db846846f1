"""What a file or folder of coilcal is, and what it holds: as lines for people and as a record for programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.cli.kinds import (
    CALIBRATION_FOLDER,
    DIAGNOSIS,
    JOBS,
    RESULT_FILE,
    SUMMARY_FILE,
    UNKNOWN,
    csv_size,
    kind_of,
    known_inside,
)
from estimator.cli.understood import rig_lines, rig_record
from estimator.cli.words import duration_words
from estimator.errors import CorruptStore, InvalidInput
from estimator.json_files import read_json
from estimator.reporting.numbers import displays, interval_with_unit, probability, quantity_words
from estimator.rig_files.read import load_rig
from estimator.store.journal import read_journal
from estimator.store.made import END, JOURNAL
from estimator.yaml_section import Section

if TYPE_CHECKING:
    from estimator.store.session import Session

MOST_LINES = 8  # of a list inside; `--json` has all of it
Contents = tuple[dict[str, Any], list[str]]


def contents_of(path: Path) -> Contents:
    """Kind and content of a path.

    Returns: A record with `kind` and what it holds, and lines that say the same.

    Raises:
        InvalidInput: There is nothing, or nothing that coilcal knows.
        CorruptStore: It is damaged.
    """
    kind = kind_of(path)
    if kind is None:
        known = ", ".join(KINDS)
        raise InvalidInput(f"path must be something that coilcal reads or writes ({known}); received {path}")
    record, lines = KINDS[kind](path)
    return {"kind": kind, **record}, [f"{path}: {kind}", *(f"  {line}" for line in lines)]


def _session(path: Path) -> Contents:
    from estimator.store.session import load_session

    session = load_session(path)
    o = session.observations
    n_validation = int(o.is_validation.sum())
    names = [sensor.name for sensor in session.rig.sensors]
    by_sensor = {name: int((o.sensor == i).sum()) for i, name in enumerate(names)}
    duration_s = float(o.time_s.max() - o.time_s.min()) if len(o) else 0.0
    record = {
        "rig": rig_record(session.rig),
        "readings": len(o),
        "validation": n_validation,
        "readings_by_sensor": by_sensor,
        "duration_s": duration_s,
        "recorded": session.created,
        "source": session.source,
        "is_simulated": bool(session.truth),
        "session_hash": session.hash,
    }
    lines = [
        f"rig {session.rig.name!r}: coils {', '.join(c.name for c in session.rig.coils)}; "
        f"movers {', '.join(f'{m.name} ({m.motion})' for m in session.rig.movers) or 'none'}",
        f"{len(o)} readings, {n_validation} of them for validation, over {duration_words(duration_s)}",
        *(f"  {name}: {number}" for name, number in by_sensor.items()),
        *_current_lines(session),
        f"recorded {session.created}; from {session.source}",
    ]
    if session.truth:
        lines.append(f"simulated, with the truth of {len(session.truth)} numbers")
    chosen, of_chosen = _chosen(path)
    return {**record, **chosen}, [*lines, *of_chosen, "next: coilcal calibrate, coilcal diagnose"]


def ending(path: Path) -> dict[str, Any]:
    """Why a session ended whose stops were chosen while it was measured; empty where they were not, or it has not ended."""
    return read_json(path / END, fault=CorruptStore) if (path / END).is_file() else {}


def _chosen(path: Path) -> Contents:
    """Goals of a session whose stops were chosen while it was measured, and the decisions; nothing for any other one."""
    header, entries = read_journal(path) if (path / JOURNAL).is_file() else ({}, [])
    goals = header.get("goals") or (["a calibration holds or has changed"] if "test" in header else [])
    if not goals:
        return {}, []
    decisions = [entry["decision"] for entry in entries]
    lines = [f"measured until {goal}" for goal in goals]
    step = max(1, len(decisions) // MOST_LINES)
    for number, decision in list(enumerate(decisions, start=1))[::step]:
        widths = decision.get("widths")
        beside = f", with {max(widths):.3g} times the wanted half-width" if widths else ""
        lines.append(f"  stop {number}{beside}: {decision['reason']}")
    end = ending(path)
    lines += [end["reason"]] if end else []
    return {"goals": goals, "decisions": decisions, "ended": end}, lines


def _current_lines(session: Session) -> list[str]:
    current_A = session.observations.current_A
    if not len(current_A):
        return []
    return [
        f"current of {coil.name}: {float(current_A[:, i].min()):g} to {float(current_A[:, i].max()):g} A"
        for i, coil in enumerate(session.rig.coils)
    ][:MOST_LINES]


def _growing(path: Path) -> Contents:
    record, lines = _session(path)
    return record, [*lines[:-1], "coilcal acquire writes it, or was interrupted: the same command goes on"]


def _calibration(path: Path) -> Contents:
    from estimator.calibration.result import Calibration

    summary = dict(Calibration.load(path).summary())
    quality = summary.get("quality", {"verdict": "not judged", "reasons": []})
    return summary, [
        f"rig {summary['rig_name']!r}; {quality['verdict']}: {' '.join(quality['reasons'])}".rstrip(": "),
        *_parameter_lines(summary["parameters"]),
        f"session: {summary['session_source']}, of {summary['session_created']}",
        "next: coilcal predict, coilcal report",
    ]


def _parameter_lines(parameters: dict[str, Any]) -> list[str]:
    """Medians and intervals in the units that other commands print: mm, mrad, µT."""
    shown_as = displays(list(parameters))
    width = max((len(each.words) for each in shown_as.values()), default=0)
    lines = []
    for name, told in list(parameters.items())[:MOST_LINES]:
        each = shown_as[name]
        median, low, high = (f"{each.factor * value:.6g}" for value in (told["median"], *told["ci90"]))
        words = f"{median}  90 %: {low} to {high}  {each.unit}"
        lines.append(f"  {each.words:{width}}  {words.rstrip()}")
    more = len(parameters) - len(lines)
    return lines if more <= 0 else [*lines, f"  and {more} more"]


def _unfinished(path: Path) -> Contents:
    return {}, [f"{path / SUMMARY_FILE} is missing: the same coilcal calibrate goes on"]


def _diagnosis(path: Path) -> Contents:
    try:
        told = read_json(path / DIAGNOSIS, fault=CorruptStore)
        lines = [f"verdict: {told['verdict']}"]
        for cause in told["causes"]:
            others = [other["name"] for other in cause.get("alternatives", [])]
            others += [UNKNOWN] if cause.get("may_be_unknown") else []
            rivals = "".join(f", or {name}" for name in others)
            lines.append(f"  {cause['name']}[{cause['place']}] ({probability(cause['probability'])}){rivals}")
            lines += _size_lines(cause)
        if told["next_measurement"]:
            lines.append(f"to tell more, measure {told['next_measurement'][0]['action']}")
        if told["ended_early"]:
            lines.append(f"the diagnosis ended early: {told['ended_early']}")
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        words = f"{type(error).__name__} {error}"
        raise CorruptStore(f"diagnosis must be readable; {path / DIAGNOSIS} is damaged: {words}") from error
    if (path / CALIBRATION_FOLDER / SUMMARY_FILE).is_file():
        lines.append(f"calibration of the extended rig: {path / CALIBRATION_FOLDER}")
    return told, [*lines, f"next: {path / 'report.html'}"]


def _size_lines(cause: dict[str, Any]) -> list[str]:
    """Sizes of a cause as `coilcal diagnose` prints them, and the difference of two that is known best."""
    lines = [
        f"    {quantity_words(key, cause['parameters']):16} {_with_interval(told)}"
        for key, told in list(cause["parameters"].items())[:MOST_LINES]
    ]
    if known := cause.get("difference"):
        plus, minus = (quantity_words(known[side]) for side in ("plus", "minus"))
        lines.append(f"    known best: {plus} − {minus} {_with_interval(known)}")
    return lines


def _with_interval(told: dict[str, Any]) -> str:
    low, high = told["ci90"]
    return interval_with_unit(told["median"], low, high, told["unit"])


def _registry(path: Path) -> Contents:
    from estimator.recalibration.registry import Registry

    registry = Registry(path)
    entries = registry.entries()
    conclusions = Counter(entry.conclusion for entry in entries)
    record = {
        "versions": list(registry.versions),
        "current": registry.current,
        "sessions": len(entries),
        "conclusions": dict(conclusions),
        "last": entries[-1].reason if entries else None,
    }
    words = ", ".join(f"{number} {conclusion}" for conclusion, number in conclusions.items())
    lines = [
        f"{len(registry.versions)} versions; in use is {registry.current or 'none'}",
        f"log: {words or 'empty'}",
    ]
    lines += [
        f"  {entry.taken or entry.concluded}  {entry.conclusion}: {entry.reason}" for entry in entries[-3:]
    ]
    return record, [*lines, f"next: {path / 'history.html'}"]


def _batch(path: Path) -> Contents:
    record = {"fits": len(list((path / JOBS).glob(f"*/{RESULT_FILE}")))}
    record["sampled"] = len(list((path / JOBS).glob(f"*/{CALIBRATION_FOLDER}/{SUMMARY_FILE}")))
    lines = [f"{record['fits']} fits, {record['sampled']} of them sampled"]
    return record, [*lines, f"next: {path / 'overview.html'}, {path / 'summary.csv'}"]


def _service(path: Path) -> Contents:
    record = {name: len(list((path / name).glob("*"))) for name in ("sessions", JOBS)}
    words = f"{record['sessions']} sessions, {record[JOBS]} jobs"
    return record, [words, "next: coilcal serve --data", "copy it with coilcal serve backup only"]


def _rig(path: Path) -> Contents:
    rig = load_rig(path)
    return {"rig": rig_record(rig)}, [*rig_lines(rig), "next: coilcal check, coilcal simulate"]


def _plan(path: Path) -> Contents:
    top = Section.from_file(path)
    parts = [key for key in ("poses", "stops", "currents_A", "largest_A") if key in top]
    name = str(top.value("name"))
    return {"name": name, "parts": parts}, [
        f"plan {name!r} with {', '.join(parts)}",
        f"next: coilcal check RIG {path} says how many stops it has",
    ]


def _readings(path: Path) -> Contents:
    header, n_rows = csv_size(path)
    return {"columns": header, "rows": n_rows}, [
        f"{n_rows} rows of {', '.join(header)}",
        f"next: coilcal check RIG {path}",
    ]


def _field(path: Path) -> Contents:
    header, n_points = csv_size(path)
    words = f"field at {n_points} points, in SI and in the world frame, with its credible interval"
    return {"columns": header, "points": n_points}, [words]


def _folder(path: Path) -> Contents:
    inside = known_inside(path)
    lines = [f"{name}: {kind}" for name, kind in inside[:MOST_LINES]]
    if len(inside) > MOST_LINES:
        counts = Counter(kind for _, kind in inside)
        lines.append(
            f"and more, in all {', '.join(f'{number} of kind {kind}' for kind, number in counts.items())}"
        )
    return {"holds": [{"name": name, "kind": kind} for name, kind in inside]}, lines


KINDS: dict[str, Callable[[Path], Contents]] = {
    "session": _session,
    "session that grows": _growing,
    "calibration": _calibration,
    "unfinished calibration": _unfinished,
    "diagnosis": _diagnosis,
    "batch": _batch,
    "data of the service": _service,
    "registry": _registry,
    "rig file": _rig,
    "plan": _plan,
    "readings CSV": _readings,
    "field CSV": _field,
    "folder": _folder,
}

"""The page of a registry: the current version, the conclusion on every session, and the parameters over time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path

from estimator.recalibration.conclusion import IS_CONVERGED
from estimator.recalibration.log import ROLLED_BACK, Entry
from estimator.recalibration.registry import Registry
from estimator.reporting.page import Picture, ReportPage, Table, render_report
from estimator.reporting.plots.history import SessionSummary, VersionInUse, history

MARGIN_SHARE = 0.05  # of the whole time, by which the last version extends beyond the last readings


def judged(entries: Sequence[Entry]) -> list[Entry]:
    """Entries about sessions; the others are rollbacks."""
    return [entry for entry in entries if entry.hash]


def summary_of(entry: Entry) -> SessionSummary:
    """A judged session; a rejected one has no estimate."""
    estimate = {} if entry.conclusion == "rejected" else entry.estimate
    label = " and ".join(cause["name"].replace("_", " ") for cause in entry.causes)
    return SessionSummary(_time(entry.taken), entry.conclusion, label, estimate)


def versions_in_use(registry: Registry, entries: Sequence[Entry]) -> list[VersionInUse]:
    """The periods of the versions in use, by the time of the readings after which they became current; empty before the first version.

    Args:
        registry: The registry.
        entries: Its log.
    """
    if registry.current is None:
        return []
    table = registry.history()
    table = table.sel(parameter=~table.is_derived)
    begins: list[tuple[datetime, int]] = []
    latest = _time(entries[0].taken)
    for entry in entries:
        latest = max(latest, _time(entry.taken)) if entry.taken else latest
        if entry.version is not None and (not begins or begins[-1][1] != entry.version):
            begins.append((latest, entry.version))
    margin = max((latest - begins[0][0]) * MARGIN_SHARE, timedelta(hours=1))
    ends = [begin for begin, _ in begins[1:]] + [latest + margin]
    return [
        VersionInUse(
            begin,
            end,
            version,
            {
                str(cell.parameter.item()): (float(cell.lower90), float(cell["median"]), float(cell.upper90))
                for cell in (table.sel(version=version, parameter=p) for p in table.parameter)
                if bool(cell["median"].notnull())
            },
        )
        for (begin, version), end in zip(begins, ends, strict=True)
    ]


def _time(text: str) -> datetime:
    return datetime.fromisoformat(text)


MOST_ROWS = 200
COUNTED = ("unchanged", "updated", "drifted", "rejected")


def history_report(registry: Registry) -> str:
    """Self-contained HTML of a registry with at least one entry in its log."""
    entries = registry.entries()
    last = next((entry for entry in reversed(entries) if entry.hash), entries[-1])
    name = "a rig" if registry.current is None else registry.calibration().rig.name
    page = ReportPage(
        title=f"Calibrations of {name}",
        subtitle=f"{_count(entries)}; last readings {_date(last.taken)}",
        verdict=_verdict(registry, entries),
        warnings=_warnings(registry, entries),
        tables=[],
        figures=[] if registry.current is None else [_picture(registry, entries, name)],
        appendix=[_table(entries)],
        provenance={"registry": str(registry.folder), "log": f"{len(entries)} entries"},
    )
    return render_report(page)


def _verdict(registry: Registry, entries: Sequence[Entry]) -> list[str]:
    if registry.current is None:
        return ["There is no calibration yet."]
    made = next(entry for entry in entries if entry.made == registry.current)
    sentences = [f"Version {registry.current} is in use, made from the readings of {_date(made.taken)}."]
    since = [entry for entry in entries if entry.hash and entry.taken > made.taken]
    agreeing = sum(1 for entry in since if entry.agrees)
    if since:
        sentences.append(f"{agreeing} of the {len(since)} sessions after it agree with it.")
    last = entries[-1]
    sentences.append(f"Last conclusion: {last.conclusion.replace('_', ' ')}. {_sentence(last)}")
    return sentences


def _warnings(registry: Registry, entries: Sequence[Entry]) -> list[str]:
    warnings = []
    last = next((entry for entry in reversed(entries) if entry.conclusion == "drifted"), None)
    if last is not None and _still_holds(last, registry.current, entries):
        warnings.append(f"Drift since {_date(last.since or last.taken)}: {_sentence(last)}")
    if entries[-1].conclusion == "rejected":
        warnings.append(f"The last session was rejected: {_sentence(entries[-1])}")
    if registry.current is not None and not registry.calibration().summary()["is_converged"]:
        warnings.append(f"Version {registry.current} did not converge; its intervals are provisional.")
    if entries[-1].made is None and entries[-1].checks.get(IS_CONVERGED) is False:
        warnings.append("The last session's calibration did not converge and replaced nothing.")
    return warnings


def _still_holds(drift: Entry, current: int | None, entries: Sequence[Entry]) -> bool:
    """Whether no other version took over since a drift, and no later session agreed with the version without it."""
    after = entries[entries.index(drift) + 1 :]
    has_ended = drift.made is None and any(entry.agrees and entry.taken > drift.taken for entry in after)
    return drift.version == current and not has_ended


def _picture(registry: Registry, entries: Sequence[Entry], name: str) -> Picture:
    sessions = judged(entries)
    summaries = [summary_of(entry) for entry in sessions]
    title = f"{name}, {_date(sessions[0].taken)} to {_date(sessions[-1].taken)}"
    caption = (
        "Points are the estimates of each session by itself, coloured by its conclusion; the blue band is the version in use. A point off "
        "the band is a change; the band steps where a new version took over."
    )
    figure = history(summaries, versions_in_use(registry, entries), title)
    return Picture("Parameters over time", caption, figure)


def _table(entries: Sequence[Entry]) -> Table:
    rows = [
        [
            _date(entry.taken or entry.concluded),
            Path(entry.session).name or "—",
            entry.conclusion.replace("_", " "),
            "—" if entry.version is None else str(entry.version),
            _sentence(entry),
        ]
        for entry in reversed(entries[-MOST_ROWS:])
    ]
    caption = "Newest first" + (
        f"; the last {MOST_ROWS} entries of the log." if len(entries) > MOST_ROWS else "."
    )
    return Table("Log", ["readings of", "session", "conclusion", "version after it", "reason"], rows, caption)


def _count(entries: Sequence[Entry]) -> str:
    sessions = [entry for entry in entries if entry.conclusion != ROLLED_BACK]
    counts = [(sum(1 for e in sessions if e.conclusion == conclusion), conclusion) for conclusion in COUNTED]
    return f"{len(sessions)} sessions: " + ", ".join(f"{n} {conclusion}" for n, conclusion in counts if n)


def _sentence(entry: Entry) -> str:
    """The reason as a sentence; the name of a cause keeps its small letter."""
    is_named = "_" in entry.reason.partition(" ")[0]
    begin = entry.reason[:1] if is_named else entry.reason[:1].upper()
    return f"{begin}{entry.reason[1:]}."


def _date(text: str) -> str:
    return text[:16].replace("T", " ")

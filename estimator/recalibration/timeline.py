"""A registry over time: the sessions that were judged, and the periods in which versions were in use."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry
from estimator.reporting.plots.history import SessionSummary, VersionInUse

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

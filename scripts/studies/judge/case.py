"""A session with what a user was told of it: texts, files, and models that were handed out."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from functools import cached_property
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from estimator.effects.circumstances import SINCE, UNTIL
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.session import load_session
from scripts.studies.judge.handed_out import HandedOut
from scripts.studies.judge.truth import Truth

INSTANTS = (f".{SINCE}", f".{UNTIL}")
SESSION, CALIBRATION, DIAGNOSIS = "session.zarr", "calibration", "diagnosis"
CALIBRATE_TEXT, DIAGNOSE_TEXT = "calibrate.txt", "diagnose.txt"


@dataclass(frozen=True)
class Case:
    """A folder with a session, a calibration and a diagnosis of it, and the truth; None where only held-out readings tell it."""

    folder: Path
    truth: Truth | None

    @cached_property
    def observations(self) -> Observations:
        """All readings."""
        return load_session(self.folder / SESSION).observations

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`summary.json` of the calibration."""
        return self._json(CALIBRATION, "summary.json")

    @cached_property
    def diagnosis(self) -> dict[str, Any]:
        """`diagnosis.json`."""
        return self._json(DIAGNOSIS, "diagnosis.json")

    @cached_property
    def plain(self) -> HandedOut:
        """What `calibrate` handed out."""
        return HandedOut.of_folder(self.folder / CALIBRATION)

    @cached_property
    def extended(self) -> HandedOut | None:
        """The calibration that `diagnose` handed out; None where it sampled none."""
        folder = self.folder / DIAGNOSIS / "calibration"
        return HandedOut.of_folder(folder) if (folder / "summary.json").exists() else None

    @cached_property
    def extended_summary(self) -> dict[str, Any]:
        """Its `summary.json`; empty where there is none."""
        return {} if self.extended is None else self._json(DIAGNOSIS, "calibration", "summary.json")

    @cached_property
    def by_diagnosis(self) -> list[HandedOut]:
        """All that `diagnose` handed out: the extended rig with its values, and its calibration.

        Where it extended nothing, the rig as described, calibrated. Nothing where that was fitted to rows that the diagnosis left out, or
        where an extended rig was not sampled: its file has priors and no values.
        """
        rig = HandedOut.of_rig_file(self.folder / DIAGNOSIS / "rig_extended.yaml")
        if self.extended is not None:
            return [rig, self.extended]
        if not set(rig.rig.acting) <= set(self.plain.rig.acting):
            return []
        return [] if self.flagged.any() else [self.plain]

    @cached_property
    def as_described(self) -> Rig:
        """The rig of the rig file; where there is none, that of the calibration."""
        path = self.folder / "rig.yaml"
        return load_rig(path) if path.exists() else self.plain.rig

    def lines(self, name: str) -> list[str]:
        """Lines of a printed text."""
        return (self.folder / name).read_text(encoding="utf-8").splitlines()

    @cached_property
    def has_open_instant(self) -> bool:
        """Whether something begins or ends at an instant: held-out readings about it, whose side is not known, judge nothing."""
        rig = load_rig(self.folder / DIAGNOSIS / "rig_extended.yaml")
        return any(name.endswith(INSTANTS) for name in rig.parameters)

    @cached_property
    def held_out(self) -> Observations:
        """Readings that no fit has seen, without what the diagnosis left out."""
        is_kept = self.without_flagged.is_validation
        return self.without_flagged.rows(is_kept)

    @cached_property
    def fitted(self) -> Observations:
        """The other readings, likewise."""
        return self.without_flagged.rows(~self.without_flagged.is_validation)

    @cached_property
    def without_flagged(self) -> Observations:
        """Readings without the components that the diagnosis flagged."""
        field_T = self.observations.field_sensor_T.clone()
        for reading, axis in zip(*np.nonzero(self.flagged), strict=True):
            field_T[reading, axis] = math.nan
        return replace(self.observations, field_sensor_T=field_T)

    @cached_property
    def flagged(self) -> np.ndarray:
        """Reading by axis, whether the diagnosis left it out."""
        flagged = np.zeros((len(self.observations), 3), dtype=bool)
        for flag in self.diagnosis["flagged"]:
            if flag["reason"] != "stuck_bit":  # which is there in all readings, so that none was left out
                flagged[rows_of(flag)[:, None], axes_of(flag)] = True
        return flagged

    @cached_property
    def tables(self) -> dict[str, list[list[str]]]:
        """Rows of the tables of the report of the diagnosis, by title, with their headers first."""
        parser = _Tables()
        parser.feed((self.folder / DIAGNOSIS / "report.html").read_text(encoding="utf-8"))
        return parser.tables

    def _json(self, *parts: str) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.folder.joinpath(*parts).read_text(encoding="utf-8"))
        return content


def rows_of(flag: dict[str, Any]) -> np.ndarray:
    """Numbers of flagged readings, from 0."""
    return np.array(flag["readings"], dtype=int) - 1


def axes_of(flag: dict[str, Any]) -> list[int]:
    """Components of a flag."""
    return [0, 1, 2] if flag["component"] is None else ["xyz".index(flag["component"])]


class _Tables(HTMLParser):
    """Tables of a report: cells as text."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: dict[str, list[list[str]]] = {}
        self._title, self._cell, self._is_title = "", None, False
        self._row: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a title, a row or a cell."""
        del attrs
        if tag == "h2":
            self._title, self._is_title = "", True
        elif tag == "tr":
            self._row = []
        elif tag in ("td", "th"):
            self._cell: str | None = ""

    def handle_data(self, data: str) -> None:
        """Text of a title or a cell."""
        if self._is_title:
            self._title += data
        elif self._cell is not None:
            self._cell += data

    def handle_endtag(self, tag: str) -> None:
        """End what was begun."""
        if tag == "h2":
            self._is_title = False
        elif tag in ("td", "th") and self._cell is not None:
            self._row.append(self._cell.strip())
            self._cell = None
        elif tag == "tr" and self._row:
            self.tables.setdefault(self._title.strip(), []).append(self._row)

"""A session with what was printed of it, which tests of the judge alter."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimator import Calibration, Session
from estimator.cli.calibrate import _text
from estimator.diagnosis.statements.moved import MOVED_TITLE
from estimator.reporting.page import ReportPage, Table, render_report
from estimator.rig_files.write import rig_text
from scripts.studies.judge.case import CALIBRATE_TEXT, DIAGNOSE_TEXT, Case
from scripts.studies.judge.statements import Statement
from scripts.studies.judge.truth import TrueCause, Truth
from scripts.studies.truthful import judged
from tests.estimator.conftest import TRUTH

GAIN = TrueCause("axis_gain", "hall", True, 9.0, {"x": 0.01})
OUTSIDE = TrueCause("chair_moved", "room", False, 9.0, {})
NAMED = {
    "name": "axis_gain",
    "probability": 0.97,
    "p_not_in_library": 0.03,
    "alternatives": [],
    "parameters": {"x": {"median": 0.0101, "sd": 0.001, "ci90": [0.0085, 0.0117]}},
}
FLAG = {
    "reason": "otherwise",
    "words": "fits another sign",
    "sensor": "hall",
    "component": None,
    "readings": [3, 4],
}
OUTLIER = {"reading": 3, "component": "x", "sensor": "hall", "probability": 0.999}
DIAGNOSED: dict[str, Any] = {"verdict": "named", "causes": [], "flagged": [], "outliers": []}
MOVED = ["parameter", "before", "after", "unit", "moved (sd)"]
Told = Callable[..., dict[str, list[Statement]]]


@pytest.fixture(scope="module")
def folder(
    small_session: Session, small_calibration: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """What `calibrate` and `diagnose` would have written, but for what a test adds."""
    made = tmp_path_factory.mktemp("judged")
    small_session.save(made / "session.zarr")
    small_calibration.save(made / "calibration")
    small_calibration.save(made / "diagnosis" / "calibration")
    rig = small_calibration.rig.with_values(
        {p.name: small_calibration.best[p.name] for p in small_calibration.rig.free}
    )
    (made / "diagnosis" / "rig_extended.yaml").write_text(rig_text(rig, ""), encoding="utf-8")
    return made


@pytest.fixture
def told(folder: Path, small_session: Session) -> Told:
    """Statements by kind of what was printed, each judged beside a truth."""
    n = len(small_session.observations)
    clean = Truth(dict(TRUTH), (), np.zeros((n, 3), dtype=bool))

    def judge(
        calibrate: str = "",
        diagnose: str = "",
        truth: Truth = clean,
        moved: list[str] | None = None,
        **diagnosed: Any,
    ) -> dict[str, list[Statement]]:
        (folder / CALIBRATE_TEXT).write_text(calibrate, encoding="utf-8")
        (folder / DIAGNOSE_TEXT).write_text(diagnose, encoding="utf-8")
        (folder / "diagnosis" / "diagnosis.json").write_text(
            json.dumps(DIAGNOSED | diagnosed), encoding="utf-8"
        )
        tables = [Table(MOVED_TITLE, MOVED, [moved])] if moved else []
        page = ReportPage("", "", [], [], [], tables, [], [], {})
        (folder / "diagnosis" / "report.html").write_text(render_report(page), encoding="utf-8")
        statements, _ = judged(Case(folder, truth))
        return {
            kind: [one for one in statements if one.kind == kind] for kind in {one.kind for one in statements}
        }

    return judge


def are_true(statements: dict[str, list[Statement]], kind: str) -> list[bool]:
    return [statement.is_true for statement in statements[kind]]


@pytest.fixture
def printed(small_calibration: Calibration) -> str:
    """What `coilcal calibrate` prints of it."""
    return _text(small_calibration.summary())


def wrong_truth(calibration: Calibration) -> Truth:
    """A truth that the intervals exclude."""
    sd = float(calibration.draws["coil1.radius_m"].std())
    return Truth(
        {**TRUTH, "coil1.radius_m": TRUTH["coil1.radius_m"] + 12.0 * sd}, (), np.zeros((36, 3), dtype=bool)
    )


def hidden(*causes: TrueCause, wrong: tuple[int, ...] = ()) -> Truth:
    """The small session with causes, and rows recorded otherwise than they were measured."""
    rows = np.zeros((36, 3), dtype=bool)
    rows[list(wrong)] = True
    return Truth(dict(TRUTH), causes, rows)


ONLY_GAIN, SMALL_GAIN, WITH_OUTSIDE = hidden(GAIN), hidden(replace(GAIN, sigma=3.0)), hidden(GAIN, OUTSIDE)


@pytest.fixture
def unseen_uT(small_calibration: Calibration) -> float:
    """What the calibration that was handed out misses unseen readings by."""
    return float(1e6 * small_calibration.summary()["rmse"]["validation"]["vector_T"])

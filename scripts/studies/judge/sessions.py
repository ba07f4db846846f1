"""Sessions that are judged: hidden ones by an independent generator, and measured maps; each in a folder as a user would have it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from estimator import block_split
from estimator.cli.output import EXIT_BAD_INPUT, EXIT_NOT_CONVERGED, EXIT_UNUSABLE
from estimator.effects import EFFECTS
from scripts.studies.diagnose_real import MICE, MORE, session_of
from scripts.studies.judge.case import (
    CALIBRATE_TEXT,
    CALIBRATION,
    DIAGNOSE_TEXT,
    DIAGNOSIS,
    SESSION,
    Case,
)
from scripts.studies.judge.statements import Statement
from scripts.studies.judge.truth import Truth
from scripts.studies.real_data import DATA_SETS
from tests.hidden import written_wrong
from tests.hidden.handed_in import HiddenSession
from tests.hidden.session import draw_session
from tests.hidden.study import PROTOCOLS, draw_case

ROWS, PLACES, MAP = "rows", "places", "map"
KINDS = ("single", "pair", "discrete", "iron", "clean", "open", "unknown12", "unforeseen30", ROWS, PLACES)
MAPS = {data_set.name: data_set for data_set in (*DATA_SETS, *MORE, *MICE)}
SHARE, SPLIT_SEED = 0.2, 1  # of a map that no fit sees, in blocks
COILCAL = [sys.executable, "-c", "from estimator.cli.main import main; main()"]
EXITS = (0, EXIT_NOT_CONVERGED, EXIT_UNUSABLE)  # outcomes, which the output tells
HIDDEN = "hidden.json"
Ran = tuple[int, str, str]


def hidden_case(kind: str, seed: int, folder: Path) -> Truth:
    """The truth of a hidden session, whose rig file and table stand in the folder."""
    wrong = None
    if kind in (ROWS, PLACES):
        hidden = draw_session(seed, None, protocol=PROTOCOLS[seed % 2])
        hidden, wrong = (_written if kind == ROWS else _placed)(hidden, seed)
    else:
        hidden = draw_case(kind, seed, EFFECTS)
    hidden.write(folder)
    truth = Truth.of(hidden, EFFECTS)
    return truth if wrong is None else replace(truth, wrong=wrong)


def _written(hidden: HiddenSession, seed: int) -> tuple[HiddenSession, np.ndarray]:
    """Readings of the first sensor written down wrongly in some rows, and which components those are."""
    rng = np.random.default_rng([17, seed])
    kinds = sorted(written_wrong.KINDS)
    kind = kinds[int(rng.integers(len(kinds)))]
    own = np.flatnonzero(hidden.schedule.sensor == 0)
    field_T = hidden.record.field_T.copy()
    measured_T = field_T[own].copy()
    field_T[own] = written_wrong.written(kind, measured_T, rng).field_T
    is_wrong = np.abs(field_T - hidden.record.field_T) > written_wrong.DIGIT_T
    return replace(hidden, record=replace(hidden.record, field_T=field_T)), is_wrong


def _placed(hidden: HiddenSession, seed: int) -> tuple[HiddenSession, np.ndarray]:
    """Places written down wrongly in some rows."""
    rng = np.random.default_rng([18, seed])
    kinds = sorted(written_wrong.PLACES)
    made = written_wrong.placed(kinds[int(rng.integers(len(kinds)))], hidden.record.displacement_m, rng)
    wrong = np.zeros(hidden.record.field_T.shape, dtype=bool)
    wrong[made.wrong] = True
    return replace(hidden, record=replace(hidden.record, displacement_m=made.place_m)), wrong


def prepared(kind: str, seed: int, folder: Path) -> tuple[Case, list[Statement]]:
    """A case whose session was imported, calibrated and diagnosed by the command line, where that was not done before.

    Returns: The case, and a statement for each command that failed; then there is no output to be judged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if kind == MAP:
        truth = None
        if not (folder / SESSION).exists():
            data_set = list(MAPS.values())[seed]
            session = session_of(data_set, Path(os.environ["COILCAL_DATA"]))
            split = block_split(session.observations, SHARE, SPLIT_SEED)
            replace(session, observations=session.observations.with_validation(split)).save(folder / SESSION)
    else:
        truth = hidden_case(kind, seed, folder)
        (folder / HIDDEN).write_text(json.dumps(truth.told, indent=2) + "\n", encoding="utf-8")
    case = Case(folder, truth)
    run = partial(_run, case)
    failed = []
    if not (folder / SESSION).exists():
        failed += run("import.txt", "import", "readings.csv", "--rig", "rig.yaml", "--out", SESSION)
    if not failed and not (folder / CALIBRATE_TEXT).exists():
        failed += run(
            CALIBRATE_TEXT, "calibrate", SESSION, "--out", CALIBRATION, "--seed", "1", "--overwrite"
        )
    if not failed and not (folder / DIAGNOSE_TEXT).exists():
        failed += run(DIAGNOSE_TEXT, "diagnose", SESSION, "--out", DIAGNOSIS, "--seed", "1", "--overwrite")
    return case, failed


def _run(case: Case, text: str, *arguments: str) -> list[Statement]:
    """Run a command in the folder of a case and keep what it prints; a statement where it fails."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, [str(Path.cwd()), os.environ.get("PYTHONPATH")])),
        "OMP_NUM_THREADS": "1",
    }
    ran = subprocess.run(
        [*COILCAL, *arguments], cwd=case.folder, env=environment, capture_output=True, text=True, check=False
    )
    return list(ended(case, text, (ran.returncode, ran.stdout, ran.stderr), arguments[0]))


def ended(case: Case, text: str, ran: Ran, command: str) -> list[Statement]:
    """What a command that ended says of the session.

    Nothing where it did its work. A crash is false, and so is the refusal of a clean session.
    """
    code, out, error = ran
    if code in EXITS:
        (case.folder / text).write_text(out, encoding="utf-8")
        return []
    (case.folder / text).with_suffix(".error").write_text(error, encoding="utf-8")
    last = (error.strip().splitlines() or [""])[-1]
    is_refusal = code == EXIT_BAD_INPUT and "Traceback" not in error
    if case.truth is None:
        is_true = is_refusal and not bool((case.observations.current_A != 0.0).any())
    else:
        is_true = is_refusal and not case.truth.is_clean
    hidden = "a measured map" if case.truth is None else case.truth.words
    kind = "refused" if is_refusal else "crash"
    return [Statement(kind, command, last, is_true, f"exit code {code}; hidden: {hidden}")]

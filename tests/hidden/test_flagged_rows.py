"""Which rows are flagged in sessions by independent code: all that a counter wrapped in, and none that iron explains, which the rig lacks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator import load_rig
from estimator.diagnosis import effort
from estimator.diagnosis.first_fit import FirstFit
from estimator.diagnosis.result import Question
from estimator.store.importers.readings_csv import read_readings_csv
from estimator.store.session import Session
from scripts.studies.written_wrong import run_case
from tests.hidden.plated_solenoid import write_plated_solenoid
from tests.hidden.session import draw_session
from tests.hidden.study import PROTOCOLS

pytestmark = pytest.mark.whole

HALF_OF_COUNTS, WRAPPED = 2**15, 43


def session_in(folder: Path) -> Session:
    return read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))


def flagged(session: Session) -> list[int]:
    """Numbers of the readings that a diagnosis leaves out before it searches."""
    first = FirstFit.of(
        Question(session.rig, session.source, 0), session, None, effort.MOST_READINGS_SEARCHED
    )
    return sorted(reading for flag in (*first.flags, *first.suspects().flags) for reading in flag.readings)


@pytest.mark.parametrize(
    ("plate_m", "opening_m"), [(0.2, 0.08), pytest.param(0.15, 0.1, marks=pytest.mark.slow)]
)
def test_no_reading_behind_an_iron_plate_is_flagged(tmp_path, plate_m, opening_m):
    """What is left of the field there is what the coils would make with one of them off or reversed, in whole ranges of place."""
    write_plated_solenoid(tmp_path, plate_m, opening_m, np.random.default_rng(4))
    assert flagged(session_in(tmp_path)) == []


@pytest.mark.parametrize("kind", ["exchanged_rows", "stale_reading", "stale_pose", "unsigned_currents"])
@pytest.mark.parametrize("seed", [93204, pytest.param(93207, marks=pytest.mark.slow)])
def test_all_rows_that_are_clearly_written_down_wrongly_are_flagged_and_no_others(kind, seed):
    """Two rows exchanged, each n-th reading or pose that of the row before, currents without their sign."""
    case = run_case(kind, seed)
    assert case.clear > 0
    assert (case.found, case.false) == (case.clear, 0)


@pytest.mark.parametrize("seed", [155203, pytest.param(155205, marks=pytest.mark.slow)])
def test_all_rows_that_a_counter_of_16_bits_wrapped_in_are_flagged_and_no_others(tmp_path, seed):
    draw_session(seed, None, protocol=PROTOCOLS[seed % 2]).write(tmp_path)
    session = session_in(tmp_path)
    field_T = session.observations.field_sensor_T.numpy()
    largest_T = np.sort(np.abs(field_T).max(axis=1))[::-1]
    count_T = np.round(0.5 * (largest_T[WRAPPED - 1] + largest_T[WRAPPED]) / HALF_OF_COUNTS, 11)
    counts = np.round(field_T / count_T)
    held = (counts + HALF_OF_COUNTS) % (2 * HALF_OF_COUNTS) - HALF_OF_COUNTS
    wrapped = np.flatnonzero((held != counts).any(axis=1)).tolist()
    assert len(wrapped) == WRAPPED
    spoilt = session.observations.with_field(torch.from_numpy(held * count_T))
    assert flagged(replace(session, observations=spoilt)) == wrapped

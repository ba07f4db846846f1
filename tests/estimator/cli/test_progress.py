"""Progress on a terminal, in a line that is drawn again, and in a pipe, by few lines; short work says nothing."""

from __future__ import annotations

from math import inf

import pytest

from estimator.acquisition.acquire import Progress as Visits
from estimator.calibration.calibrate import Stage
from estimator.cli import progress
from estimator.cli.progress import COUNTED_EVERY_S, LINE_EVERY_S, UNTOLD_S, Reporter, TimeLeft, left_words
from estimator.diagnosis.progress import Progress
from estimator.inference.ensemble import Progress as Sampled
from estimator.inference.laplace import OpenDirection
from estimator.store.growing import StopReadings

ROOM_OR_ZERO = {"background_field[room].x_T": 0.7, "sensor_offset[hall].x_T": -0.7}  # which a note tells of
STAGES = (
    Stage("point estimate"),
    Stage(
        "Laplace",
        open_directions=(
            OpenDirection("coil1 thickness", 3.0, {"coil1 thickness": 1.0}),
            OpenDirection("room or zero", 9.0, ROOM_OR_ZERO),
        ),
    ),
    Stage("sampling", Sampled(50, 1000, 120.0, 2000.0, 1.0123)),
    Stage("sampling", Sampled(100, 1000, 250.0, 2000.0, 1.0071)),
)
SEVENTH = Progress("step 2", 7, 16, 20.3)
WORDS = "step 2: 7 of up to 16 hypotheses fitted, at most about 20 s of fits left"


@pytest.fixture
def now_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def report_calibration() -> None:
    with Reporter() as reporter:
        for stage in STAGES:
            reporter.calibration(stage)


def test_a_pipe_gets_every_line_of_a_calibration_once_and_plainly(capsys):
    report_calibration()
    assert capsys.readouterr().err.splitlines() == [
        "point estimate",
        "Laplace",
        "  not determined by the data: coil1 thickness",
        "sampling",
        "  step 50, effective samples 120 of 2000, R-hat 1.0123",
        "  step 100, effective samples 250 of 2000, R-hat 1.0071",
    ]


def test_the_time_left_follows_from_what_was_done_since_the_beginning(now_s):
    left = TimeLeft()
    assert left.seconds(50.0, 250.0) == inf
    now_s[0] += 10.0
    assert left.seconds(100.0, 250.0) == 30.0
    assert left.seconds(250.0, 250.0) == 0.0
    assert left.seconds(0.0, 100.0) == inf  # something new
    now_s[0] += 1.0
    assert left_words(left.seconds(1.0, 100.0)) == ", about 1 min 39 s left"
    assert left_words(left.seconds(99.9, 100.0)) == ""


def test_a_pipe_hears_nothing_of_two_seconds_and_then_little(now_s, capsys):
    with Reporter(COUNTED_EVERY_S, UNTOLD_S, UNTOLD_S) as reporter:
        for n in range(9):
            now_s[0] = 100.0 + 1.5 * n
            reporter.count("predicting points", 10 * n, 100)
    assert capsys.readouterr().err == "coilcal: predicting points: 20 of 100, about 12 s left\n"


def test_a_pipe_gets_every_stage_of_a_diagnosis_and_fits_only_now_and_then(now_s, capsys):
    with Reporter(LINE_EVERY_S, LINE_EVERY_S) as reporter:
        reporter.stage("searching for causes")
        for now_s[0] in (110.0, 120.0, 131.0, 140.0, 150.0):
            reporter.fits(SEVENTH)
    assert capsys.readouterr().err.splitlines() == ["coilcal: searching for causes", f"coilcal: {WORDS}"]


def test_what_is_not_as_it_should_be_with_a_stop_is_said_once(capsys):
    reading = (2.0, [3.0], {"arm1": [0.0] * 6}, {"hall": [0.0] * 3}, False, 0)
    good = StopReadings(*reading, n_gaps={"hall": 0})
    bad = StopReadings(*reading, is_settled=False, n_gaps={"hall": 2})
    with Reporter(5.0) as reporter:
        for number, stop in enumerate((good, bad, good), start=1):
            reporter.visits(Visits(number, 3, 3.0 - number, stop))
    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if line.startswith("coilcal: ")] == [
        "coilcal: hall lost readings at stop 2; it is marked so in the journal",
        "coilcal: the field at stop 2 had not settled; it is marked so in the journal",
    ]

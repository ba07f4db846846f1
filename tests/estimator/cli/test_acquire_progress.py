"""What an operator reads while a plan is carried out, in a pipe."""

from __future__ import annotations

import pytest

from estimator.acquisition.acquire import Progress
from estimator.cli.progress import Reporter
from estimator.store.growing import StopReadings


def test_what_is_not_as_it_should_be_with_a_stop_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    motion = {"arm1": [0.0] * 6}
    good = StopReadings(1.0, [3.0], motion, {"hall": [0.0] * 3}, False, 0, n_gaps={"hall": 0})
    bad = StopReadings(
        2.0, [3.0], motion, {"hall": [0.0] * 3}, False, 0, is_settled=False, n_gaps={"hall": 2}
    )
    with Reporter(5.0) as reporter:
        for number, stop in enumerate((good, bad, good), start=1):
            reporter.visits(Progress(number, 3, 3.0 - number, stop))
    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if line.startswith("coilcal: ")] == [
        "coilcal: hall lost readings at stop 2; it is marked so in the journal",
        "coilcal: the field at stop 2 had not settled; it is marked so in the journal",
    ]

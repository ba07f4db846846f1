"""`coilcal acquire` killed again and again, at any instant from its start to its end: nothing it said is lost, and no current stays on."""

from __future__ import annotations

import itertools
import os
import random
import re
import signal
import subprocess
import time

import pytest

from estimator.store.journal import JOURNAL, read_journal
from estimator.store.session import is_growing, load_session
from tests.estimator.cli.test_acquire import bring_home, call, folder, is_off
from tests.program import PYTHON, launched

__all__ = ["folder"]  # the fixture of a rig that runs

N_KILLS = 50
OFF_S = 10.0
SAYING_EACH_STOP = (
    "import estimator.cli.acquire_task as task; task.LINE_EVERY_S = 0.0; "
    "from estimator.cli.main import main; main(prog_name='coilcal')"
)


def killed(arguments: list[str], after_s: float) -> tuple[int, str]:
    """Exit code and what was said; the clock runs from the start of the program."""
    program = launched(PYTHON, "-c", SAYING_EACH_STOP, *arguments)
    try:
        _, said = program.communicate(timeout=after_s)
    except subprocess.TimeoutExpired:
        os.kill(program.pid, signal.SIGKILL)
        _, said = program.communicate()
    return program.returncode, said


@pytest.mark.slow
def test_killed_at_50_random_instants_a_measurement_loses_and_doubles_nothing(folder, tmp_path):
    draw = random.Random(5)
    bring_home(folder)
    n_kills, n_sessions = 0, 0
    begun_s = time.monotonic()
    out = tmp_path / "session0.zarr"
    code, said = killed(call(folder, out), 60.0)
    whole_s = time.monotonic() - begun_s
    assert code == 0, said
    n_stops = len(load_session(out).observations)
    out = tmp_path / "session1.zarr"
    known: list[dict[str, object]] = []
    while n_kills < N_KILLS:
        code, said = killed(call(folder, out), whole_s * (0.2 + 0.8 * draw.random()))
        assert "Traceback" not in said
        deadline_s = time.monotonic() + OFF_S
        while not is_off(folder):
            assert time.monotonic() < deadline_s
        acknowledged = max((int(number) for number in re.findall(r"^stop (\d+) of", said, re.M)), default=0)
        if (out / JOURNAL).exists():
            records = read_journal(out)[1]
            assert records[: len(known)] == known
            assert len(records) >= acknowledged
            assert len(load_session(out).observations) == len(records) <= n_stops
            known = records
        else:
            assert acknowledged == 0
        assert code in (0, -signal.SIGKILL), said
        n_kills += code == -signal.SIGKILL
        if out.exists() and not is_growing(out):
            assert len(known) == n_stops
            assert all(earlier["time_s"] < later["time_s"] for earlier, later in itertools.pairwise(known))
            n_sessions += 1
            out, known = tmp_path / f"session{n_sessions + 1}.zarr", []
            bring_home(folder)
        else:
            assert code != 0
    assert n_sessions >= 1

"""Simulated sessions of the paper's coil, the diagnosis of two of them, and a session that grows."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from estimator.benchmarks.rows import Row, timed
from estimator.diagnosis.diagnose import diagnose
from estimator.live.stream import Stream
from estimator.model.simulate import draw_truth, simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import plan_from_text
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.follow import Follower
from estimator.store.growing import StopReadings, new_header, observations_of
from estimator.store.journal import Entry, Journal
from estimator.store.session import Session

RIG = Path(__file__).with_name("paper_simulation.yaml")  # as in configs, which no wheel has
OTHER = 100  # between the seeds of two sessions of the same rig
HIDDEN: dict[str, dict[str, float]] = {"nothing wrong": {}, "a gain error": {"axis_gain.x": 0.01}}


def grid_plan(n: int) -> str:
    """Plan of n x n x n places in the paper's workspace, one reading each, in random order."""
    return f"""\
schema_version: 1
name: {n**3} readings
poses:
  calibration:
    arm1: {{x_mm: {{from: -50, to: 50, count: {n}}}, y_mm: {{from: -50, to: 50, count: {n}}}, z_mm: {{from: -25, to: 25, count: {n}}}}}
currents_A: [{{coil1: 3}}]
order: random
settle_s: 0.5
"""


def grid_readings(n: int, seed: int) -> tuple[Rig, Observations]:
    """The paper's rig and n x n x n simulated readings of it."""
    rig = load_rig(RIG)
    truth = draw_truth(rig, seed)
    return rig, simulate(rig, plan_from_text(grid_plan(n), rig), truth, seed=seed)


def diagnosis_rows(n: int, repeats: int, seed: int) -> list[Row]:
    """Seconds of a diagnosis of n x n x n readings with nothing wrong and with a gain error; all causes are candidates.

    Another session of as many readings validates. Each repeat has readings of its own; the first ones compile and do not count.
    """
    seconds: dict[str, list[float]] = {name: [] for name in HIDDEN}
    for turn in range(repeats + 1):
        for name, hidden in HIDDEN.items():
            taken_s = diagnosis_s(n, seed + turn, hidden)
            if turn:
                seconds[name].append(taken_s)
    return [Row(f"diagnosis of {n**3} readings, {name}", "s", tuple(seconds[name])) for name in HIDDEN]


def diagnosis_s(n: int, seed: int, hidden: dict[str, float]) -> float:
    """Seconds of one diagnosis, without the simulation of its two sessions."""
    rig = load_rig(RIG)
    plan, truth = plan_from_text(grid_plan(n), rig), draw_truth(rig, seed)
    session, validation = (
        Session(rig, simulate(rig, plan, truth, seed=s, hidden=hidden), "simulated")
        for s in (seed, OTHER + seed)
    )
    return timed(lambda: diagnose(session, validation=validation, seed=seed))


def live_rows(n: int, n_timed: int, repeats: int, seed: int) -> list[Row]:
    """Milliseconds from the writing of a reading on disk to the estimate that holds it, a median over the last ones of each repeat.

    Writer and reader are one process, so the time between two looks (2 ms in `coilcal live`) is not in it.
    """
    rig, readings = grid_readings(n, seed)
    medians_ms = [1e3 * statistics.median(delays_s(rig, readings, n_timed)) for _ in range(repeats + 1)]
    name = f"{len(readings)} readings, from a reading on disk to the estimate"
    return [Row(name, "ms", tuple(medians_ms[1:]))]  # the first compiles


def delays_s(rig: Rig, readings: Observations, n_timed: int) -> list[float]:
    """Seconds of each of the last readings of a growing session: append, wait for the disk, read, update."""
    n_before = len(readings) - n_timed
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.zarr"
        header = new_header(rig, "benchmark", "plan", {}, len(readings))
        with Journal.create(path, header) as journal:
            journal.append_all([entry_of(readings, row) for row in range(n_before)])
            follower, stream = Follower(path), Stream(rig)
            update(follower, stream)

            def one(row: int) -> Callable[[], None]:
                def call() -> None:
                    journal.append(entry_of(readings, row))
                    update(follower, stream)

                return call

            return [timed(one(row)) for row in range(n_before, len(readings))]


def update(follower: Follower, stream: Stream) -> None:
    """Take what is new on disk into the estimate."""
    stream.update(observations_of(follower.entries(), stream.rig))


def entry_of(readings: Observations, row: int) -> Entry:
    """The entry of a journal that a stop writes."""
    motion = {name: motion[row].tolist() for name, motion in readings.motion.items()}
    field_T = {"hall": readings.field_sensor_T[row].tolist()}
    current_A = readings.current_A[row].tolist()
    return StopReadings(time.monotonic(), current_A, motion, field_T, False, 0).entry()

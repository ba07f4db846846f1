"""Delay from writing a stop to the journal until the estimate holds it, over a session of 500 readings."""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import tempfile
import time
from pathlib import Path

import torch

from estimator import Observations, draw_truth, load_plan, load_rig, simulate
from estimator.cli.live_session import POLL_S
from estimator.live.stream import Stream
from estimator.store.follow import Follower
from estimator.store.growing import StopReadings, new_header, observations_of
from estimator.store.journal import Journal

RIG, PLAN = "configs/paper_simulation.yaml", "configs/plans/recommended.yaml"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readings", type=int, default=500)
    parser.add_argument("--pause-s", type=float, default=0.2, help="between two stops")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rig = load_rig(RIG)
    plan = load_plan(PLAN, rig)
    truth = draw_truth(rig, options.seed)
    parts = [
        simulate(rig, plan, truth, seed=options.seed + i).alone for i in range(1 + options.readings // 200)
    ]
    readings = parts[0]
    for part in parts[1:]:
        readings = readings.followed_by(part)
    readings = readings.rows(torch.arange(options.readings)).with_validation(
        torch.zeros(options.readings, dtype=torch.bool)
    )
    with tempfile.TemporaryDirectory() as folder:
        session = Path(folder) / "session.zarr"
        writer = multiprocessing.get_context("spawn").Process(
            target=write, args=(session, readings, options.pause_s)
        )
        writer.start()
        delays_s = follow(session, options.readings)
        writer.join()
    print(f"{'readings':>12} {'median':>9} {'90 %':>9} {'longest':>9}   from the disk to the estimate")
    for first in range(0, options.readings, 100):
        part_s = sorted(delays_s[first : first + 100])
        values = (statistics.median(part_s), part_s[int(0.9 * len(part_s))], part_s[-1])
        print(f"{first + 1:>5} to {first + len(part_s):>3} " + " ".join(f"{1e3 * v:6.0f} ms" for v in values))


def write(session: Path, readings: Observations, pause_s: float) -> None:
    """Body of the process that measures; the time of each stop is taken before it is written."""
    rig = load_rig(RIG)
    with Journal.create(session, new_header(rig, "benchmark", "plan", {}, len(readings))) as journal:
        for row in range(len(readings)):
            motion = {name: motion[row].tolist() for name, motion in readings.motion.items()}
            field_T = {"hall": readings.field_sensor_T[row].tolist()}
            now_s = time.monotonic()
            current_A = readings.current_A[row].tolist()
            journal.append(StopReadings(now_s, current_A, motion, field_T, False, 0).entry())
            time.sleep(pause_s)


def follow(session: Path, n_readings: int) -> list[float]:
    """Delay of each reading since its writing began."""
    while not session.exists():
        time.sleep(POLL_S)
    follower = Follower(session)
    rig = follower.rig
    stream = Stream(rig)
    delays_s: list[float] = []
    while len(delays_s) < n_readings:
        records = follower.entries()
        if not records:
            time.sleep(POLL_S)
            continue
        stream.update(observations_of(records, rig))
        now_s = time.monotonic()
        delays_s += [now_s - record["time_s"] for record in records]
    return delays_s


if __name__ == "__main__":
    main()

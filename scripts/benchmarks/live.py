"""Delay from writing a stop to the journal until the estimate holds it, in sessions of some sizes; `make bench-live` runs it.

The writer is a process of its own and waits for the disk. A session holds most of its readings from the beginning; those of the last stops
are timed. Medians of several runs, and the processor time that following takes.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from multiprocessing.synchronize import Event
from pathlib import Path

import torch

from estimator import Observations, draw_truth, load_plan, load_rig, simulate
from estimator.benchmarks.sessions import entry_of
from estimator.cli.live_session import POLL_S
from estimator.live.stream import Stream
from estimator.store.follow import Follower
from estimator.store.growing import new_header, observations_of
from estimator.store.journal import Journal

RIG, PLAN = "configs/paper_simulation.yaml", "configs/plans/recommended.yaml"
N_TIMED = 60


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readings", type=int, nargs="*", default=[100, 500, 5000])
    parser.add_argument("--pause-s", type=float, default=0.2, help="between two stops")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"load {os.getloadavg()[0]:.1f}, {os.cpu_count()} processors; {options.repeats} runs of {N_TIMED} stops"
    )
    print(
        "readings   ms from the writing of a stop to the estimate   of which processor time   share of a core"
    )
    for number in options.readings:
        readings = readings_of(number, options.seed)
        runs = [run(readings, options.pause_s) for _ in range(options.repeats)]
        delays_ms = [1e3 * statistics.median(delays_s) for delays_s, _, _ in runs]
        updates_ms = [1e3 * statistics.median(updates_s) for _, updates_s, _ in runs]
        share = statistics.median(share for _, _, share in runs)
        print(
            f"{number:>8}   {statistics.median(delays_ms):5.1f} ({min(delays_ms):.1f} to {max(delays_ms):.1f}), slowest of all "
            f"{1e3 * max(max(delays_s) for delays_s, _, _ in runs):.0f}   {statistics.median(updates_ms):5.1f} ({min(updates_ms):.1f} to "
            f"{max(updates_ms):.1f})   {share:.1%}",
            flush=True,
        )


def readings_of(number: int, seed: int) -> Observations:
    """So many readings of one coil, the plan again and again with fresh noise."""
    rig = load_rig(RIG)
    plan, truth = load_plan(PLAN, rig), draw_truth(rig, seed)
    readings = simulate(rig, plan, truth, seed=seed).alone
    while len(readings) < number:
        seed += 1
        readings = readings.followed_by(simulate(rig, plan, truth, seed=seed).alone)
    none = torch.zeros(number, dtype=torch.bool)
    return readings.rows(torch.arange(number)).with_validation(none)


def run(readings: Observations, pause_s: float) -> tuple[list[float], list[float], float]:
    """Delays of the last stops, processor time of each update, and share of a core that following took."""
    with tempfile.TemporaryDirectory() as folder:
        session = Path(folder) / "session.zarr"
        spawn = multiprocessing.get_context("spawn")
        is_ready = spawn.Event()
        writer = spawn.Process(target=write, args=(session, readings, pause_s, is_ready))
        writer.start()
        result = follow(session, len(readings), is_ready.set)
        writer.join()
        return result


def write(session: Path, readings: Observations, pause_s: float, is_ready: Event) -> None:
    """Body of the process that measures; the time of each stop is taken before it is written."""
    header = new_header(load_rig(RIG), "benchmark", "plan", {}, len(readings))
    n_before = len(readings) - N_TIMED
    with Journal.create(session, header) as journal:
        journal.append_all([entry_of(readings, row) for row in range(n_before)])
        is_ready.wait()
        for row in range(n_before, len(readings)):
            time.sleep(pause_s)
            journal.append(entry_of(readings, row))


def follow(
    session: Path, n_readings: int, begin: Callable[[], None]
) -> tuple[list[float], list[float], float]:
    """As `coilcal live` does, without its screen and its background."""
    while not session.exists():
        time.sleep(POLL_S)
    follower = Follower(session)
    rig = follower.rig
    stream = Stream(rig)
    n_read = 0
    while n_read < n_readings - N_TIMED:
        if entries := follower.entries():
            n_read += len(entries)
            stream.update(observations_of(entries, rig))
    begin()
    begin_s, begin_processor_s = time.monotonic(), time.process_time()
    delays_s: list[float] = []
    updates_s: list[float] = []
    while len(delays_s) < N_TIMED:
        before_s = time.process_time()
        entries = follower.entries()
        if not entries:
            time.sleep(POLL_S)
            continue
        stream.update(observations_of(entries, rig))
        now_s = time.monotonic()
        updates_s.append(time.process_time() - before_s)
        delays_s += [now_s - entry["time_s"] for entry in entries]
    share = (time.process_time() - begin_processor_s) / (time.monotonic() - begin_s)
    return delays_s, updates_s, share


if __name__ == "__main__":
    main()

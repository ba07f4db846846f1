"""Delay from writing a stop to the journal until the estimate holds it, and distance of the estimate from the batch fit.

`make bench-live` runs it. The writer is a process of its own and waits for the disk. A session holds most of its readings from the
beginning; those of the last stops are timed. Between stops the estimate is polished as `coilcal live` does. Medians of several runs, and
the processor time that following takes. Distances to the batch fit are those of some stops of the first run: right after the reading, and
when the next one is written.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path

import torch
from torch import Tensor

from estimator import Observations, draw_truth, load_plan, load_rig, simulate
from estimator.benchmarks.sessions import entry_of, grid_readings
from estimator.cli.live_session import POLL_S
from estimator.inference.levenberg_marquardt import (
    gradient_and_information,
    levenberg_marquardt,
    prior_gradient_and_precision,
)
from estimator.inference.likelihood import LogPosterior
from estimator.inference.positive_definite import inverse
from estimator.live.engine import ProcessorShare
from estimator.live.stream import Stream
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Coordinates
from estimator.store.follow import Follower
from estimator.store.growing import new_header, observations_of
from estimator.store.journal import Journal

RIG, PLAN = "configs/paper_simulation.yaml", "configs/plans/recommended.yaml"
N_TIMED = 60
COMPARED_EVERY = 6
PLACES = ("of the plan", "of their own")


@dataclass
class Run:
    """What following the last stops took.

    Attributes:
        delays_s: From the writing of a stop to its estimate.
        updates_s: Processor time of each update.
        share: Of a core, over all of it.
        n_polished: Stops whose estimate was polished when the next one was written, or the session ended.
        first, last: Estimates with so many readings, right after the last of them, and when the next one was written.
    """

    delays_s: list[float] = field(default_factory=list)
    updates_s: list[float] = field(default_factory=list)
    share: float = math.nan
    n_polished: int = 0
    first: dict[int, dict[str, Tensor]] = field(default_factory=dict)
    last: dict[int, dict[str, Tensor]] = field(default_factory=dict)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readings", type=int, nargs="*", default=[100, 500, 5000])
    parser.add_argument("--pause-s", type=float, default=0.2, help="between two stops")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"load {os.getloadavg()[0]:.1f}, {os.cpu_count()} processors; {options.repeats} runs of {N_TIMED} stops, "
        f"{options.pause_s:g} s apart; medians, smallest to largest run in brackets, and the largest of all stops"
    )
    for number in options.readings:
        for places in PLACES:
            readings = readings_of(number, options.seed, places)
            runs = [run(readings, options.pause_s) for _ in range(options.repeats)]
            print(f"{number} readings at places {places}", flush=True)
            print(f"  from the writing of a stop to the estimate: {in_ms([one.delays_s for one in runs])}")
            print(f"  of which processor time: {in_ms([one.updates_s for one in runs])}")
            shares = sorted(one.share for one in runs)
            print(f"  share of a core: {statistics.median(shares):.1%} ({shares[0]:.1%} to {shares[-1]:.1%})")
            n_polished = sum(one.n_polished for one in runs)
            print(f"  polished when the next stop was written: {n_polished} of {N_TIMED * len(runs)}")
            first_sd, last_sd = distances_sd(runs[0], readings)
            for words, values in (("right after a reading", first_sd), ("when the next one came", last_sd)):
                middle, most = statistics.median(values), max(values)
                print(f"  standard deviations from the batch fit {words}: {middle:.1e}, largest {most:.1e}")


def in_ms(runs_s: list[list[float]]) -> str:
    """Median over the runs of their medians, with the range of these and the largest number of all."""
    medians = sorted(1e3 * statistics.median(one) for one in runs_s)
    largest = 1e3 * max(max(one) for one in runs_s)
    middle = statistics.median(medians)
    return f"{middle:.1f} ({medians[0]:.1f} to {medians[-1]:.1f}) ms, largest {largest:.0f}"


def readings_of(number: int, seed: int, places: str) -> Observations:
    """So many readings of one coil: the plan again and again with fresh noise, or each at a place of its own."""
    if places == PLACES[0]:
        rig = load_rig(RIG)
        plan, truth = load_plan(PLAN, rig), draw_truth(rig, seed)
        readings = simulate(rig, plan, truth, seed=seed).alone
        while len(readings) < number:
            seed += 1
            readings = readings.followed_by(simulate(rig, plan, truth, seed=seed).alone)
    else:
        _, readings = grid_readings(math.ceil(number ** (1.0 / 3.0)), seed)
    none = torch.zeros(number, dtype=torch.bool)
    return readings.rows(torch.arange(number)).alone.with_validation(none)


def run(readings: Observations, pause_s: float) -> Run:
    """One session, written by another process."""
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


def follow(session: Path, n_readings: int, begin: Callable[[], None]) -> Run:
    """As `coilcal live` does, without its screen and its background."""
    while not session.exists():
        time.sleep(POLL_S)
    follower = Follower(session)
    rig = follower.rig
    stream, share = Stream(rig), ProcessorShare()
    n_read = 0
    while n_read < n_readings - N_TIMED:
        if entries := follower.entries():
            n_read += len(entries)
            stream.update(observations_of(entries, rig))
    while stream.can_polish:
        stream.polish()
    begin()
    begin_s, begin_processor_s = time.monotonic(), time.process_time()
    result = Run()
    while n_read < n_readings or stream.can_polish:
        before_s = time.process_time()
        entries = follower.entries()
        if not entries:
            if stream.can_polish and share.is_left():
                stream.polish()
            else:
                time.sleep(POLL_S)
            continue
        ends_compared = n_read in result.first
        if n_read > n_readings - N_TIMED:
            result.n_polished += stream.is_polished
        if ends_compared:
            result.last[n_read] = stream.values
            before_s = time.process_time()
        stream.update(observations_of(entries, rig))
        now_s = time.monotonic()
        result.updates_s.append(time.process_time() - before_s)
        result.delays_s += [now_s - entry["time_s"] for entry in entries]
        n_read += len(entries)
        if n_read % COMPARED_EVERY == 0:
            result.first[n_read] = stream.values
    result.n_polished += stream.is_polished
    if n_read in result.first:
        result.last[n_read] = stream.values
    result.share = (time.process_time() - begin_processor_s) / (time.monotonic() - begin_s)
    return result


def distances_sd(run: Run, readings: Observations) -> tuple[list[float], list[float]]:
    """Largest difference of a coordinate from that of the batch fit, in standard deviations of the posterior, first and last."""
    first_sd, last_sd = [], []
    for n, values in run.first.items():
        maximum, sd, coordinates = batch_fit(readings.rows(torch.arange(n)).alone)
        for distances, estimate in ((first_sd, values), (last_sd, run.last[n])):
            vector = coordinates.vector({name: float(value) for name, value in estimate.items()})
            distances.append(float(((vector - maximum) / sd).abs().max()))
    return first_sd, last_sd


def batch_fit(readings: Observations) -> tuple[Tensor, Tensor, Coordinates]:
    """Maximum of the posterior, its standard deviations and its coordinates: Levenberg-Marquardt, then Newton steps.

    Levenberg-Marquardt alone ends up to 1e-5 standard deviations away, where the density no longer rises by more than rounding.
    """
    rig = load_rig(RIG)
    coordinates = Coordinates(rig)
    posterior = LogPosterior(coordinates, MeasurementModel.build(rig, readings), readings)
    fit = levenberg_marquardt(posterior, coordinates.start()[None])
    vector = fit.vector
    for _ in range(8):
        gradient, _ = gradient_and_information(posterior, vector, posterior.to_first_order(vector))
        gradient = gradient + prior_gradient_and_precision(coordinates, vector)[0]
        vector = vector + torch.linalg.solve(fit.precision, gradient)
    return vector[0], inverse(fit.precision[0]).diagonal().sqrt(), coordinates


if __name__ == "__main__":
    main()

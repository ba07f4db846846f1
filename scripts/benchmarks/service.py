"""How long `coilcal serve` takes for an appended batch, an estimate and predictions, over loopback and beside the same in process.

    python -m scripts.benchmarks.service

Starts a service in a process of its own, calibrates a small simulated session there, and prints medians and 99th percentiles.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
import torch

from estimator import SamplerSettings, Session, load_plan, load_rig, simulate
from estimator.calibration.result import Calibration
from estimator.client import Client, RemoteCalibration

PROGRAM = [sys.executable, "-c", "from estimator.cli.main import main; main(prog_name='coilcal')"]
RIG, PLAN = Path("configs/paper_simulation.yaml"), Path("configs/plans/paper_grid.yaml")
BATCH, BATCHES = 20, 100
WATCHED, PAUSE_S = 500, 0.1
POINTS, PREDICTIONS = 1000, 20
CLIENTS, SMALL, FOR_S = (1, 4, 16), (1, 100), 4.0
QUICK = SamplerSettings(target_ess=100.0, largest_rhat=1.2, max_steps=1000)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        call = ["serve", "--data", folder, "--port", "0", "--workers", "1"]
        process = subprocess.Popen([*PROGRAM, *call], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        try:
            assert process.stdout is not None
            url = process.stdout.readline().decode().split()[-1]
            for n_clients in (1, 10):
                appends(url, n_clients)
            watched(url)
            predictions(url, Path(folder), process.pid)
        finally:
            process.terminate()
            process.communicate()


def appends(url: str, n_clients: int) -> None:
    """Batches of readings, from several clients at once."""

    def stream(number: int) -> list[float]:
        rig = load_rig(RIG)
        reading = {
            "current_A": {coil.name: 3.0 for coil in rig.coils},
            "motion": {mover.name: [0.0] * 6 for mover in rig.movers},
            "field_T": {rig.sensors[0].name: [1e-3, 2e-3, 3e-3]},
        }
        with Client(url) as client:
            session = client.begin(rig, f"client {number}")
            batches = [
                [{"sequence": i, "time_s": float(i), **reading} for i in range(first, first + BATCH)]
                for first in range(0, BATCH * BATCHES, BATCH)
            ]
            return [took_s(lambda batch=batch: session.append(batch)) for batch in batches]

    begin_s = time.perf_counter()
    with ThreadPoolExecutor(n_clients) as pool:
        times_s = [t for times in pool.map(stream, range(n_clients)) for t in times]
    rate = n_clients * BATCH * BATCHES / (time.perf_counter() - begin_s)
    tell(f"append {BATCH} readings, {n_clients} clients", times_s)
    print(f"  {rate:.0f} readings a second in all")


def watched(url: str) -> None:
    """From the request that appends a reading to the event with the estimate that holds it."""
    rig = load_rig(RIG)
    o = simulate(rig, load_plan(PLAN, rig), {}, seed=1)
    repeats = range(-(-WATCHED // len(o)))
    rows = [row for _ in repeats for row in range(len(o))][:WATCHED]
    sent_s: list[float] = []
    held_s: list[float] = []
    taken = threading.Condition()

    def follow(session_id: str) -> None:
        with httpx.stream("GET", f"{url}/v1/sessions/{session_id}/live", timeout=60) as events:
            for line in events.iter_lines():
                if not line.startswith("data:"):
                    continue
                n = json.loads(line[5:])["n_appended"]
                with taken:
                    held_s.extend([time.perf_counter()] * (n - len(held_s)))
                    taken.notify()
                if n == WATCHED:
                    return

    with Client(url) as client:
        session = client.begin(rig, "watched")
        watcher = threading.Thread(target=follow, args=(session.id,), daemon=True)
        watcher.start()
        for number, row in enumerate(rows):
            reading = {
                "sequence": number,
                "time_s": float(number),
                "current_A": {coil.name: 3.0 for coil in rig.coils},
                "motion": {name: columns[row].tolist() for name, columns in o.motion.items()},
                "field_T": {rig.sensors[0].name: o.field_sensor_T[row].tolist()},
            }
            sent_s.append(time.perf_counter())
            session.append([reading])
            with taken:
                taken.wait_for(lambda n=number: len(held_s) > n, timeout=60)
            time.sleep(PAUSE_S)
        watcher.join(60)
    times_s = [held - sent for sent, held in zip(sent_s, held_s, strict=True)]
    for first in range(0, WATCHED, WATCHED // 5):
        last = first + WATCHED // 5
        tell(f"from an appended reading to its estimate, readings {first + 1} to {last}", times_s[first:last])


def predictions(url: str, data: Path, pid: int) -> None:
    """Predictions of a thousand points, and many small ones from several clients at once, beside the same in process.

    Processor time of the service for each does not depend on what else the computer does.
    """
    rig = load_rig(RIG)
    session = Session(rig, simulate(rig, load_plan(PLAN, rig), {}, seed=1), "simulated")
    currents_A = {coil.name: 2.0 for coil in rig.coils}
    with Client(url) as client:
        there = client.calibrate(session, settings=QUICK)
        (folder,) = data.glob("jobs/*/calibration")
        here = Calibration.load(folder)
        for where, calibration in (("service", there), ("in process", here)):
            for name in ("field", "field_interval"):
                call = asked(calibration, name, points(POINTS, 0), currents_A)
                call()
                tell(f"{where}: {name} of {POINTS} points", [took_s(call) for _ in range(PREDICTIONS)])
    for n_points in SMALL:
        for name in ("field", "field_interval"):
            what = f"{name} of {n_points} points"
            before_s = time.process_time()
            n, here_by_s = rate(asked(here, name, points(n_points, 0), currents_A))
            cpu_s = (time.process_time() - before_s) / (n + 1)
            print(
                f"{what}, in process, one after another: {here_by_s:.0f} a second, {1e3 * cpu_s:.0f} ms of a processor each"
            )
            for n_clients in CLIENTS:

                def ask(number: int, name: str = name, n_points: int = n_points) -> tuple[int, float]:
                    with Client(url) as client:
                        calibration = client.calibration(there.id)
                        return rate(asked(calibration, name, points(n_points, number), currents_A))

                before_s = cpu_of(pid)
                with ThreadPoolExecutor(n_clients) as pool:
                    done = list(pool.map(ask, range(n_clients)))
                cpu_s = (cpu_of(pid) - before_s) / sum(n + 1 for n, _ in done)
                by_s = sum(each_by_s for _, each_by_s in done)
                print(
                    f"{what}, {n_clients} clients: {by_s:.0f} a second, {1e3 * cpu_s:.0f} ms of a processor each",
                    flush=True,
                )


def points(n: int, seed: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).uniform(-0.02, 0.02, (n, 3)))


def cpu_of(pid: int) -> float:
    """Processor time of a process, its workers excepted, in s."""
    numbers = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(numbers[11]) + int(numbers[12])) / os.sysconf("SC_CLK_TCK")


def rate(call: Callable[[], object]) -> tuple[int, float]:
    """Calls one after another, besides a first one: their number, and calls a second."""
    call()
    n, begin_s = 0, time.perf_counter()
    while (passed_s := time.perf_counter() - begin_s) < FOR_S:
        call()
        n += 1
    return n, n / passed_s


def asked(
    calibration: Calibration | RemoteCalibration,
    name: str,
    points_m: torch.Tensor,
    currents_A: dict[str, float],
) -> Callable[[], object]:
    return lambda: getattr(calibration, name)(points_m, currents_A)


def took_s(call: Callable[[], object]) -> float:
    begin_s = time.perf_counter()
    call()
    return time.perf_counter() - begin_s


def tell(what: str, times_s: Sequence[float]) -> None:
    median_s, high_s = np.quantile(times_s, [0.5, 0.99])
    print(f"{what}: median {1e3 * median_s:.1f} ms, 99th percentile {1e3 * high_s:.1f} ms", flush=True)


if __name__ == "__main__":
    main()

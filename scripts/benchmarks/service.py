"""How long `coilcal serve` takes for an appended batch and for a prediction, over loopback.

    python -m scripts.benchmarks.service

Starts a service in a process of its own, calibrates a small simulated session there, and prints medians and 99th percentiles.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch

from estimator import SamplerSettings, Session, load_plan, load_rig, simulate
from estimator.client import Client, RemoteCalibration

PROGRAM = [sys.executable, "-c", "from estimator.cli.main import main; main(prog_name='coilcal')"]
RIG, PLAN = Path("configs/paper_simulation.yaml"), Path("configs/plans/paper_grid.yaml")
BATCH, BATCHES = 20, 100
POINTS, PREDICTIONS = 1000, 20
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
            predictions(url)
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


def predictions(url: str) -> None:
    """Predictions of a thousand points."""
    rig = load_rig(RIG)
    session = Session(rig, simulate(rig, load_plan(PLAN, rig), {}, seed=1), "simulated")
    points_m = torch.from_numpy(np.random.default_rng(0).uniform(-0.02, 0.02, (POINTS, 3)))
    currents_A = {coil.name: 2.0 for coil in rig.coils}
    with Client(url) as client:
        there = client.calibrate(session, settings=QUICK)
        for name in ("field", "field_interval"):
            tell(
                f"{name} of {POINTS} points",
                [took_s(asked(there, name, points_m, currents_A)) for _ in range(PREDICTIONS)],
            )


def asked(
    calibration: RemoteCalibration, name: str, points_m: torch.Tensor, currents_A: dict[str, float]
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

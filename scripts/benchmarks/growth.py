"""Time and peak memory of calibrations and fits as they grow, each in a process of its own; `make bench-growth` runs it.

One quantity grows and the others stay: readings, loops of the winding, coils, sensors, walkers, and starts that are fitted together, as a
diagnosis fits its hypotheses. The exponent of each curve is the slope of a straight line through the logarithms of the larger half of its
sizes, where what is constant no longer counts.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch

from estimator import SamplerSettings, Session, calibrate, draw_truth
from estimator.benchmarks.machine import processor
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from scripts.benchmarks.machine import peak_memory_GB, use_cores

SEED = 4
NOISE_T = 20e-6
# What grows, the sizes it takes, and its words.
SIZES: dict[str, tuple[tuple[int, ...], str]] = {
    "readings": ((125, 500, 2_000, 8_000, 32_000, 200_000), "fit, and the density at 100 draws"),
    "loops": ((64, 256, 1_024, 4_096, 16_384), "full sum at 2000 readings"),
    "coils": ((1, 2, 4, 8), "fit of all coils, 500 readings each"),
    "sensors": ((1, 2, 4, 8), "fit of all sensors, 500 readings each"),
    "walkers": ((32, 128, 512, 2_048), "density of all walkers, 2000 readings"),
    "hypotheses": ((1, 4, 16, 64), "fits of 500 readings, all together"),
}
WHOLE = "calibration"  # `coilcal calibrate` of a large session


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=(*SIZES, WHOLE), nargs="*", default=[*SIZES, WHOLE])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--most", type=int, default=200_000, help="leave larger sizes out")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--json", type=Path, default=Path("out/growth.json"))
    parser.add_argument("--child", nargs=2, metavar=("WHAT", "SIZE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(measured(options.child[0], int(options.child[1]), options.repeats)))
        return
    print(
        f"{processor()}, load {os.getloadavg()[0]:.1f}; processor seconds, median of {options.repeats}, one core"
    )
    rows: dict[str, dict[str, Any]] = {}
    for what in options.only:
        sizes = (
            (options.most,) if what == WHOLE else [size for size in SIZES[what][0] if size <= options.most]
        )
        rows[what] = {str(size): in_child(what, size, options.repeats) for size in sizes}
        show(what, rows[what])
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    if options.figure is not None:
        draw(rows, options.figure)


def in_child(what: str, size: int, repeats: int) -> dict[str, Any]:
    command = [
        sys.executable,
        "-m",
        "scripts.benchmarks.growth",
        "--child",
        what,
        str(size),
        "--repeats",
        str(repeats),
    ]
    result: dict[str, Any] = json.loads(subprocess.check_output(command))
    return result


def measured(what: str, size: int, repeats: int) -> dict[str, Any]:
    """Body of the process: processor seconds of each repeat, and peak memory with and without them."""
    use_cores(1)
    torch.set_num_threads(1)
    work = task(what, size)
    before_GB = peak_memory_GB()
    seconds = []
    for _ in range(1 if what == WHOLE else repeats):
        begin_s = time.process_time()
        work()
        seconds.append(time.process_time() - begin_s)
    return {"seconds": seconds, "peak_GB": peak_memory_GB(), "before_GB": before_GB}


def task(what: str, size: int) -> Callable[[], object]:
    """What is measured, set up."""
    n_coils, n_sensors = (size if what == name else 1 for name in ("coils", "sensors"))
    n_readings = {"readings": size, WHOLE: size, "loops": 2_000, "walkers": 2_000}.get(
        what, 500 * n_coils * n_sensors
    )
    loops = round(math.sqrt(size)) if what == "loops" else 24
    rig = rig_of(n_coils, n_sensors, loops, has_free_coils=what != "loops")
    observations = readings_of(rig, n_readings)
    if what == WHOLE:
        session = Session(rig, observations, "simulated")
        return lambda: calibrate(session, seed=SEED, settings=SamplerSettings(max_steps=20, check_every=20))
    tolerance = 0.0 if what == "loops" else 1e-6
    model = MeasurementModel.build(rig, observations, tolerance)
    posterior = LogPosterior(Coordinates(rig), model, observations)
    start = posterior.coordinates.start()
    n_rows = {"walkers": size, "readings": 100}.get(what, 1)
    near = start + 1e-3 * posterior.coordinates.scale * torch.randn(
        n_rows, len(start), dtype=torch.float64, generator=torch.Generator().manual_seed(SEED)
    )

    def density() -> None:
        with torch.no_grad():
            posterior(near)

    if what in ("walkers", "loops"):
        return density
    starts = near[:1].expand(size, -1) if what == "hypotheses" else near[:1]

    def fit() -> None:
        levenberg_marquardt(posterior, starts, max_iterations=8)
        if what == "readings":
            density()

    return fit


def rig_of(n_coils: int, n_sensors: int, loops: int, has_free_coils: bool) -> Rig:
    """Coils side by side, each with a free radius, height and tilt; sensors side by side on a stage, each with a free noise and gain."""
    radius, height, tilt = (
        (f"{{prior: {{normal: {{mean: {mean}, sd: {sd}}}}}}}" if has_free_coils else f"{mean}")
        for mean, sd in ((50, 1), (-60, 1), (0, 2))
    )
    coils = "".join(
        f"  coil{i + 1}: {{radius_mm: {radius}, wire_radius_mm: {12 / loops:.6g}, axial_loops: {loops}, radial_loops: {loops}, "
        f"world_from_coil: {{x_mm: {120 * i}, z_mm: {height}, tilt_x_deg: {tilt}}}}}\n"
        for i in range(n_coils)
    )
    noise = "{prior: {log_normal: {median: 20, relative_sd: 0.5}}}"
    sensors = "".join(
        f"  hall{i + 1}: {{carried_by: stage, noise_uT: {noise}, flange_from_sensor: {{y_mm: {10 * i}}}}}\n"
        for i in range(n_sensors)
    )
    return rig_from_text(
        f"schema_version: 1\nname: growth\nmovers: {{stage: {{motion: pose}}}}\ncoils:\n{coils}sensors:\n{sensors}"
    )


def readings_of(rig: Rig, n: int) -> Observations:
    """Readings at places of their own above the coils, one coil and one sensor after the other, by the model with noise."""
    random = np.random.default_rng(SEED)
    motion = np.zeros((n, 6))
    motion[:, :3] = random.uniform([-40.0, -40.0, 5.0], [40.0, 40.0, 60.0], (n, 3)) * 1e-3
    coil, sensor = np.arange(n) % len(rig.coils), np.arange(n) // len(rig.coils) % len(rig.sensors)
    motion[:, 0] += 0.12 * coil
    empty = Observations.of(
        torch.from_numpy(3.0 * np.eye(len(rig.coils))[coil]),
        {"stage": torch.from_numpy(motion)},
        torch.zeros(n, 3, dtype=torch.float64),
        sensor=torch.from_numpy(sensor),
    )
    truth = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    truth |= {name: torch.tensor(value, dtype=torch.float64) for name, value in draw_truth(rig, SEED).items()}
    with torch.no_grad():
        field_T = MeasurementModel.build(rig, empty).predict(truth).expand(n, 3)
    return replace(empty, field_sensor_T=field_T + NOISE_T * torch.from_numpy(random.standard_normal((n, 3))))


def exponent(rows: dict[str, Any]) -> float:
    """Slope of log time in log size over the larger half of the sizes."""
    sizes = [int(size) for size in rows][len(rows) // 2 - 1 :]
    times = [float(np.median(rows[str(size)]["seconds"])) for size in sizes]
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def show(what: str, rows: dict[str, Any]) -> None:
    print(
        f"\n{what}: {SIZES[what][1] if what in SIZES else 'point estimate, Laplace, 20 steps of 32 walkers, summary'}"
    )
    for size, row in rows.items():
        s = row["seconds"]
        print(
            f"{size:>9} {float(np.median(s)):9.3f} s ({min(s):.3f} to {max(s):.3f})   peak {row['peak_GB']:.2f} GB, "
            f"of which {row['before_GB']:.2f} before"
        )
    if len(rows) > 2:
        print(f"time grows as {what} to the power of {exponent(rows):.2f}", flush=True)


def draw(rows: dict[str, dict[str, Any]], path: Path) -> None:
    """Time and peak memory against size, a line for each quantity."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (of_time, of_memory) = plt.subplots(1, 2, figsize=(9.0, 3.8))
    for what, of_size in rows.items():
        if what == WHOLE:
            continue
        sizes = [int(size) for size in of_size]
        s = np.array([np.percentile(row["seconds"], [0, 50, 100]) for row in of_size.values()])
        (line,) = of_time.plot(sizes, s[:, 1], "o-", ms=3, label=f"{what}: power {exponent(of_size):.2f}")
        of_time.fill_between(sizes, s[:, 0], s[:, 2], color=line.get_color(), alpha=0.25)
        of_memory.plot(
            sizes, [row["peak_GB"] for row in of_size.values()], "o-", ms=3, color=line.get_color()
        )
    of_memory.axhline(4.0, color="0.4", ls="--", lw=1)
    of_memory.annotate("4 GB", (1.0, 4.05), color="0.3")
    of_time.set(xscale="log", yscale="log", xlabel="number of what grows", ylabel="processor time, s")
    of_memory.set(
        xscale="log", xlabel="number of what grows", ylabel="peak memory of the process, GB", ylim=(0, 4.5)
    )
    figure.legend(loc="upper center", ncol=3, fontsize=8)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.88))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()

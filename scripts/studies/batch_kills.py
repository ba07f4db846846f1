"""A batch whose workers or client are killed with SIGKILL gives the same files as one left undisturbed; `make batch-kills` runs it.

200 simulated sessions, three of them damaged, go through `coilcal batch` three times: undisturbed; with a worker killed at each of
several shares of the work; and with the client, which holds the scheduler, killed there and the same command repeated. All result files
are compared byte by byte. Then the same command is repeated once more, and must do nothing and say so.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from estimator import Session, draw_truth, load_plan, load_rig, simulate

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = [sys.executable, "-c", "from estimator.cli.main import main; main(prog_name='coilcal')"]
RIG = """\
schema_version: 1
name: a coil quick to calibrate
movers:
  arm1: {motion: displacement}
coils:
  coil1:
    carried_by: arm1
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: 0.98
    axial_loops: {prior: {normal: {mean: 12, sd: 1, lower: 1}}}
    radial_loops: 3
    world_from_coil0:
      x_mm: {prior: {normal: {mean: 0, sd: 3}}}
      z_mm: {prior: {normal: {mean: -40, sd: 3}}}
sensors:
  hall: {noise_uT: 5}
"""
PLAN = """\
schema_version: 1
name: 27 points
poses:
  calibration:
    arm1: {x_mm: {from: -40, to: 40, count: 3}, y_mm: {from: -40, to: 40, count: 3}, z_mm: {from: -20, to: 20, count: 3}}
currents_A: [{coil1: 3}]
"""
N_DAMAGED = 3
KILLED_AT = (0.02, 0.2, 0.4, 0.6, 0.8)  # shares of finished fits and posteriors
LOOK_EVERY_S = 0.1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/batch_kills"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    paths = sessions(options.out, options.sessions, options.seed)
    call = ["batch", *map(str, paths), "--workers", str(options.workers), "--ess", "100", "--json"]
    study = {"alone": undisturbed, "worker_killed": with_workers_killed, "client_killed": with_client_killed}
    for name, run in study.items():
        folder = options.out / name
        if not (folder / "summary.csv").exists():  # written last by a batch
            shutil.rmtree(folder, ignore_errors=True)
            run(call, folder, len(paths) - N_DAMAGED)
    expected = digests(options.out / "alone")
    for name in study:
        folder = options.out / name
        received, before = digests(folder), times(folder)
        different = [
            file for file in expected.keys() | received.keys() if expected.get(file) != received.get(file)
        ]
        print(f"{name}: {len(received)} result files, {len(different)} of them differ from those in alone")
        ended(started(call, folder), "the same command again", len(paths) - N_DAMAGED)
        written = [file for file, time_ns in times(folder).items() if before.get(file) != time_ns]
        print(f"  result files written: {len(written)}", flush=True)
        if different or written:
            sys.exit(
                f"batch_kills: files of {name} must equal those of alone and stay unchanged; received {(different + written)[:5]}"
            )


def undisturbed(call: Sequence[str], folder: Path, n_good: int) -> None:
    for path, why in ended(started(call, folder), "undisturbed", n_good).items():
        print(f"  {Path(path).name}: {why.replace(str(Path(path).parent), '...')}", flush=True)


def with_workers_killed(call: Sequence[str], folder: Path, n_good: int) -> None:
    running = started(call, folder)
    for share in KILLED_AT:
        wait_for(running, folder, share * 2 * n_good)
        os.kill(workers_of(running.pid)[0], signal.SIGKILL)
        print(f"  killed a worker after {n_done(folder)} of {2 * n_good} results", flush=True)
    ended(running, "workers killed", n_good)


def with_client_killed(call: Sequence[str], folder: Path, n_good: int) -> None:
    for share in KILLED_AT:
        running = started(call, folder)
        wait_for(running, folder, share * 2 * n_good)
        running.kill()
        running.communicate()
        print(f"  killed the client after {n_done(folder)} of {2 * n_good} results", flush=True)
    ended(started(call, folder), "client killed", n_good)


def sessions(out: Path, number: int, seed: int) -> list[Path]:
    """Sessions of coils drawn from the priors; the 10th, the middle one and the last cannot be read."""
    paths = [out / "sessions" / f"s{i:03d}.zarr" for i in range(number)]
    if paths[0].parent.exists():
        return paths
    (out / "rig.yaml").write_text(RIG, encoding="utf-8")
    (out / "plan.yaml").write_text(PLAN, encoding="utf-8")
    rig = load_rig(out / "rig.yaml")
    plan = load_plan(out / "plan.yaml", rig)
    partial = out / "sessions.partial"
    shutil.rmtree(partial, ignore_errors=True)
    made = [partial / path.name for path in paths]
    for i, path in enumerate(made):
        readings = simulate(rig, plan, draw_truth(rig, seed + i), seed=seed + i)
        Session(rig, readings, "simulated", "2026-01-01T00:00:00+00:00").save(path)
    truncated, garbled, poor = made[min(9, number // 4)], made[number // 2], made[-1]
    chunk = next((truncated / "field_sensor_T").rglob("c/*/*"))
    chunk.write_bytes(chunk.read_bytes()[:-5])
    (garbled / "zarr.json").write_bytes(b"\x00garbled")
    shutil.rmtree(poor / "current_A")
    partial.rename(out / "sessions")
    return paths


def started(call: Sequence[str], out: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [*PROGRAM, *call, "--out", str(out)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment,
    )


def wait_for(running: subprocess.Popen[str], out: Path, results: float) -> None:
    while n_done(out) < results or not workers_of(running.pid):
        if running.poll() is not None:
            sys.exit(f"batch_kills: the batch ended before the kill ({n_done(out)} results)")
        time.sleep(LOOK_EVERY_S)


def n_done(out: Path) -> int:
    """Number of finished fits and posteriors."""
    jobs = list((out / "jobs").glob("[!.]*"))
    return len(jobs) + sum((path / "calibration").exists() for path in jobs)


def workers_of(client: int) -> list[int]:
    """Processes of the local cluster: children of the client that multiprocessing spawned."""
    pids = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == client and b"spawn_main" in (folder / "cmdline").read_bytes():
                pids.append(int(folder.name))
        except OSError:
            continue  # it ended meanwhile
    return sorted(pids)


def ended(running: subprocess.Popen[str], what: str, n_good: int) -> dict[str, str]:
    begin_s = time.monotonic()
    output: dict[str, Any] = json.loads(running.communicate()[0])
    print(
        f"{what}: exit code {running.returncode}, {output['fits']} fits, {output['sampled']} sampled, {output['new']} of both new, "
        f"{len(output['failed'])} failed, {time.monotonic() - begin_s:.0f} s",
        flush=True,
    )
    failed: dict[str, str] = output["failed"]
    if running.returncode == 0 or len(failed) != N_DAMAGED:
        sys.exit("batch_kills: the damaged sessions must be reported")
    if output["fits"] != n_good or output["sampled"] != n_good:
        sys.exit("batch_kills: every good session must have its posterior")
    return failed


def digests(out: Path) -> dict[str, str]:
    """SHA-256 of the table, every fit and every file of the posteriors."""
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in results(out)
    }


def times(out: Path) -> dict[str, int]:
    return {
        str(path.relative_to(out)): path.stat().st_mtime_ns for path in results(out) if path.parent != out
    }


def results(out: Path) -> list[Path]:
    files = [path for path in (out / "jobs").rglob("*") if path.is_file()]
    return [out / "summary.csv", *sorted(files)]


if __name__ == "__main__":
    main()

"""Jobs of a service whose workers are killed at random instants end with the bytes of jobs let alone; part of `make service-storm`.

    python -m scripts.studies.service_job_storm --kills 20 --seed 1

The same jobs of every kind run twice, in two services: first undisturbed, then while a worker is killed with SIGKILL every few seconds.
Where they are done before the last kill, they are asked for again. A job on which four workers died is given up, so none loses more than
three. Ends with 1 where one did not finish, or a file differs. Leave the checkout alone meanwhile: fits name the commit that made them.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from estimator import Session, draw_truth, load_plan, load_rig, simulate
from estimator.batching.engine import DEATHS_ALLOWED
from estimator.client import Client
from estimator.rig.rig import Rig
from scripts.studies.batch_kills import PLAN, RIG, workers_of
from scripts.studies.service_process import ServiceProcess

SETTINGS = {"n_walkers": 32, "target_ess": 1e6, "max_steps": 600}  # a chain of a fixed length
SHORTEST_S, LONGEST_S = 1.0, 16.0  # between two kills; a new worker takes seconds to begin
LOOK_EVERY_S = 0.2
RESULTS = ("calibration", "diagnosis", "fits", "conclusion.json", "batch.json", "design.json")
PAGE = "report.html"  # names its job
MOMENT = re.compile(rb'"concluded": "[^"]*"')


class Storm:
    """A service with the jobs of the study.

    Args:
        data: Its data folder.
        sessions: What they are about.
    """

    def __init__(self, data: Path, sessions: list[Session]) -> None:
        self.data, self.service = data, ServiceProcess(data)
        self.client = Client(self.service.url)
        self.session_ids = [self.client.upload(session) for session in sessions]
        self.asked: dict[str, str] = {}  # name of what was asked for, by the id of the job

    def ask(self, is_first: bool) -> None:
        """Ask for every job; a session is judged once only."""
        for name, body in bodies(self.session_ids):
            kind = name.split()[0]
            if kind == "recalibrate" and not is_first:
                continue
            self.asked[self.client.request("POST", f"/v1/jobs/{kind}", json=body).json()["id"]] = name

    def states(self) -> dict[str, dict[str, Any]]:
        """Every job by its id."""
        return {job["id"]: job for job in self.client.pages("/v1/jobs")}

    def is_at_work(self) -> bool:
        """Whether a job waits or runs."""
        return any(job["state"] in ("queued", "running") for job in self.states().values())

    def end(self) -> None:
        """End the service."""
        self.client.close()
        self.service.end()

    def files(self, job_id: str) -> dict[str, bytes]:
        """What a job has left, without what differs between two services: ids, their folder and moments."""
        folder = self.data / "jobs" / job_id
        paths = [path for name in RESULTS for path in ((folder / name), *(folder / name).rglob("*"))]
        found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths if path.is_file()}
        ids = {session_id.encode(): b"session %d" % i for i, session_id in enumerate(self.session_ids)}
        return {
            named(name, ids): MOMENT.sub(b"", replaced(content, {**ids, str(self.data).encode(): b"data"}))
            for name, content in found.items()
            if not name.endswith(PAGE)
        }


def bodies(session_ids: list[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What is asked for, by a name that begins with the kind of the job."""
    yield "recalibrate", {"session_id": session_ids[0], "settings": SETTINGS}
    yield "diagnose", {"session_id": session_ids[1], "seed": 1, "most_causes": 1}
    hypotheses = ["plain", "axis_gain", "sensor_offset"]
    yield "batch", {"session_ids": session_ids, "hypotheses": hypotheses, "settings": SETTINGS}
    yield "design", {"session_id": session_ids[0], "shrink": "coil1.radius_m", "n_readings": 10}
    for seed in range(1, 7):
        body = {"session_id": session_ids[seed % 2], "seed": seed, "settings": SETTINGS}
        yield f"calibrate {seed}", body


def replaced(content: bytes, words: dict[bytes, bytes]) -> bytes:
    for word, other in words.items():
        content = content.replace(word, other)
    return content


def named(name: str, words: dict[bytes, bytes]) -> str:
    return replaced(name.encode(), words).decode()


def sessions_of(folder: Path, seed: int) -> list[Session]:
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    (folder / "plan.yaml").write_text(PLAN, encoding="utf-8")
    rig: Rig = load_rig(folder / "rig.yaml")
    plan = load_plan(folder / "plan.yaml", rig)
    moment = "2026-01-01T00:00:00+00:00"
    return [
        Session(rig, simulate(rig, plan, draw_truth(rig, number), seed=number), "simulated", moment)
        for number in (seed, seed + 1)
    ]


def undisturbed(storm: Storm) -> dict[str, dict[str, bytes]]:
    """Files of every job by its name."""
    begin_s = time.monotonic()
    storm.ask(is_first=True)
    while storm.is_at_work():
        time.sleep(LOOK_EVERY_S)
    print(f"{len(storm.asked)} jobs undisturbed: {time.monotonic() - begin_s:.0f} s", flush=True)
    return {name: storm.files(job_id) for job_id, name in storm.asked.items()}


def disturbed(storm: Storm, kills: int, seed: int) -> None:
    """The same jobs, again and again until all kills were done."""
    instants, n_killed, deaths = random.Random(seed), 0, Counter[str]()
    storm.ask(is_first=True)
    while n_killed < kills or storm.is_at_work():
        if n_killed == kills:
            time.sleep(LOOK_EVERY_S)
            continue
        time.sleep(instants.uniform(SHORTEST_S, LONGEST_S))
        if not storm.is_at_work():
            storm.ask(is_first=False)
        running = [job_id for job_id, job in storm.states().items() if job["state"] == "running"]
        workers = workers_of(storm.service.process.pid)
        if workers and all(deaths[job_id] < DEATHS_ALLOWED for job_id in running):
            os.kill(workers[0], signal.SIGKILL)
            n_killed += 1
            deaths.update(running)
            names = ", ".join(storm.asked[job_id] for job_id in running)
            print(f"kill {n_killed}: {names or 'no job'} at work", flush=True)


def main() -> None:
    """Run the jobs twice and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sessions = sessions_of(folder, arguments.seed)
        alone = Storm(folder / "alone", sessions)
        expected = undisturbed(alone)
        alone.end()
        storm = Storm(folder / "storm", sessions)
        disturbed(storm, arguments.kills, arguments.seed)
        states = storm.states()
        storm.end()
        unfinished = {storm.asked[i]: job["fault"] for i, job in states.items() if job["state"] != "done"}
        different = {}
        n_files = 0
        for job_id, what in storm.asked.items():
            left = storm.files(job_id)
            n_files += len(left)
            names = {
                file
                for file in left.keys() | expected[what].keys()
                if left.get(file) != expected[what].get(file)
            }
            if names:
                different[what] = sorted(names)[:5]
    print(
        f"{arguments.kills} kills of workers, {len(storm.asked)} jobs: {len(unfinished)} not finished, {len(different)} with other bytes "
        f"in {n_files} files"
    )
    for words in (unfinished, different):
        for what, why in words.items():
            print(f"{what}: {why}")
    sys.exit(1 if unfinished or different else 0)


if __name__ == "__main__":
    main()

"""A month of a service in minutes: small jobs, appended readings, predictions, watchers and schedules, and what grows meanwhile.

    python -m scripts.studies.service_soak --minutes 25

Clients do little things as fast as the service takes them, and delete all but the last jobs and sessions. Every half minute the script
notes memory, threads and open files of the service and its workers, and bytes on disk. In the end it prints a table, and growth per
thousand operations over the second half: what a service remembers for ever shows there. The log may grow, and the data folder until as
much is deleted as comes.
"""

from __future__ import annotations

import argparse
import contextlib
import http.server
import json
import os
import random
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import httpx
import numpy as np

from estimator import Session, draw_truth, load_plan, load_rig, simulate
from estimator.service.settings import ENVIRONMENT
from scripts.studies.service_process import ServiceProcess

RIG, PLAN = Path("configs/paper_simulation.yaml"), Path("configs/plans/routine_check.yaml")
QUICK = {"n_walkers": 32, "target_ess": 50.0, "largest_rhat": 1.5, "max_steps": 200}
NOTE_EVERY_S, ROWS = 30.0, 12
BATCH, BATCHES = 20, 30  # readings of a request, and requests of a session
MOST_CALIBRATIONS = 60  # that predictions go round among
MEGA = 1e6


class Work:
    """What the clients share: the address, what there is to ask about, and how often each thing was done."""

    def __init__(self, url: str, folder: Path, keep: int) -> None:
        self.url, self.folder, self.keep, self.rig = url, folder, keep, load_rig(RIG)
        self.done: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self.is_over = threading.Event()
        self.calibrations: list[str] = []
        self.ended_jobs: list[str] = []
        self.closed_sessions: list[str] = []
        with httpx.Client(base_url=url, timeout=60) as http:
            text = RIG.read_text(encoding="utf-8")
            self.rig_id = _posted(http, "/v1/rigs", "application/yaml", text)["id"]
            # Readings that are streamed belong to a rig of another name, which no schedule judges.
            other = text.replace("name: paper, simulated coil", "name: streamed", 1)
            assert other != text
            self.streamed_id = _posted(http, "/v1/rigs", "application/yaml", other)["id"]
            self.session_ids = [self.measured(http, seed) for seed in (1, 2)]

    def measured(self, http: httpx.Client, seed: int) -> str:
        """Upload a simulated session."""
        from estimator.store.importers.readings_csv import write_readings_csv

        truth = draw_truth(self.rig, 1)
        observations = simulate(self.rig, load_plan(PLAN, self.rig), truth, seed)
        path = self.folder / "readings.csv"
        write_readings_csv(Session(self.rig, observations, f"soak {seed}"), path)
        address = f"/v1/sessions/import-csv?rig_id={self.rig_id}"
        return str(_posted(http, address, "text/csv", path.read_bytes())["id"])

    def repeat(self, name: str, do: Callable[[httpx.Client], object], pause_s: float) -> None:
        """Do something again and again until the end; what is refused is counted."""
        with httpx.Client(base_url=self.url, timeout=120) as http:
            while not self.is_over.is_set():
                try:
                    do(http)
                    self.done[name] += 1
                except (httpx.HTTPError, AssertionError, KeyError) as error:
                    self.faults[f"{name}: {type(error).__name__} {str(error)[:80]}"] += 1
                self.is_over.wait(pause_s)

    def stream(self, http: httpx.Client) -> None:
        """Begin a session, append to it while another client watches, and close it."""
        body = {"rig_id": self.streamed_id, "source": "soak"}
        session_id = http.post("/v1/sessions", json=body).raise_for_status().json()["id"]
        watcher = threading.Thread(target=self._watch, args=(session_id,), daemon=True)
        watcher.start()
        for first in range(0, BATCH * BATCHES, BATCH):
            lines = b"".join(self._line(number) for number in range(first, first + BATCH))
            _posted(http, f"/v1/sessions/{session_id}/readings", "application/x-ndjson", lines)
            self.done["appends"] += 1
            if self.is_over.is_set():
                break
        http.post(f"/v1/sessions/{session_id}/close").raise_for_status()
        watcher.join(timeout=60)
        self.closed_sessions.append(session_id)

    def _watch(self, session_id: str) -> None:
        """Every other watcher leaves before the end, without a word."""
        most = random.choice((3, 10_000))
        with (
            contextlib.suppress(httpx.HTTPError),
            httpx.stream("GET", f"{self.url}/v1/sessions/{session_id}/live", timeout=120) as events,
        ):
            for number, line in enumerate(events.iter_lines()):
                self.done["live events"] += line.startswith("data:")
                if number > most:
                    return

    def _line(self, sequence: int) -> bytes:
        rng = np.random.default_rng(sequence)
        reading = {
            "sequence": sequence,
            "time_s": 0.1 * sequence,
            "current_A": {coil.name: 3.0 for coil in self.rig.coils},
            "motion": {mover.name: [*rng.uniform(-0.02, 0.02, 3), 0, 0, 0] for mover in self.rig.movers},
            "field_T": {self.rig.sensors[0].name: rng.normal(1e-3, 1e-5, 3).tolist()},
        }
        return json.dumps(reading).encode() + b"\n"

    def predict(self, http: httpx.Client) -> None:
        """Ask one of the calibrations for a field at a point."""
        if not self.calibrations:
            return
        name = random.choice(self.calibrations[-MOST_CALIBRATIONS:])
        point = [random.uniform(-0.02, 0.02), 0.0, 0.02]
        body = {"points_m": [point], "currents_A": {self.rig.coils[0].name: 3.0}}
        answer = http.post(f"/v1/calibrations/{name}/predict", json=body)
        if answer.status_code != 404 or name in self.calibrations:  # else it was deleted just now
            answer.raise_for_status()

    def calibrate(self, http: httpx.Client) -> None:
        """Ask for a job and follow it to its end; every tenth is cancelled."""
        body = {"session_id": self.session_ids[0], "seed": random.randrange(1 << 30), "settings": QUICK}
        job_id = http.post("/v1/jobs/calibrate", json=body).raise_for_status().json()["id"]
        is_cancelled = random.random() < 0.1
        if is_cancelled:
            self.is_over.wait(random.uniform(0.0, 2.0))
            http.post(f"/v1/jobs/{job_id}/cancel")
        with http.stream("GET", f"/v1/jobs/{job_id}/events", timeout=300) as events:
            for _ in events.iter_lines():
                pass
        job = http.get(f"/v1/jobs/{job_id}").json()
        assert job["state"] == "done" or is_cancelled, job["fault"]
        if job["state"] == "done":
            self.calibrations.append(http.get(f"/v1/jobs/{job_id}/result").json()["calibration_id"])
        self.ended_jobs.append(job_id)

    def delete(self, http: httpx.Client) -> None:
        """Delete all but the last jobs and streamed sessions, as `keep_jobs_days` and users do."""
        for kind, ids in (("jobs", self.ended_jobs), ("sessions", self.closed_sessions)):
            while len(ids) > self.keep:
                if kind == "jobs" and (calibration := self._calibration_of(http, ids[0])) is not None:
                    self.calibrations.remove(calibration)
                http.delete(f"/v1/{kind}/{ids[0]}").raise_for_status()
                assert http.get(f"/v1/{kind}/{ids.pop(0)}").status_code == 404
                self.done[f"deleted {kind}"] += 1

    def _calibration_of(self, http: httpx.Client, job_id: str) -> str | None:
        answer = http.get(f"/v1/jobs/{job_id}/result")  # a cancelled job has none
        return str(answer.json()["calibration_id"]) if answer.is_success else None

    def look(self, http: httpx.Client) -> None:
        """What a page, a monitor and somebody who errs ask for."""
        for path in ("/", "/v1/rigs", "/v1/sessions", "/v1/jobs", "/metrics", "/readyz", "/v1/none"):
            assert http.get(path).status_code in (200, 404)
        http.get(f"/v1/sessions/{random.choice(self.session_ids)}/readings.csv").raise_for_status()
        assert http.post("/v1/rigs", content=b"{", headers={"Content-Type": "application/yaml"}).is_error

    def new_session(self, http: httpx.Client) -> None:
        """One more session for the schedule to judge."""
        self.measured(http, 10 + self.done["sessions to judge"])


def _posted(http: httpx.Client, path: str, kind: str, body: str | bytes) -> dict[str, str]:
    answer = http.post(path, content=body, headers={"Content-Type": kind})
    return dict(answer.raise_for_status().json())


class Usage:
    """What a process and those below it use, from /proc."""

    def __init__(self, pid: int, data: Path) -> None:
        self.pid, self.data, self.begin_s = pid, data, time.monotonic()

    def row(self, work: Work) -> dict[str, float]:
        """Numbers of this moment."""
        workers = [pid for child in _children(self.pid) for pid in (child, *_children(child))]
        # os.walk passes over folders that are deleted meanwhile.
        files = [Path(folder, name) for folder, _, names in os.walk(self.data) for name in names]
        log = self.data.with_suffix(".log")
        return {
            "min": (time.monotonic() - self.begin_s) / 60.0,
            "operations": sum(work.done.values()),
            "service MB": _rss_MB(self.pid),
            "workers MB": sum(map(_rss_MB, workers)),
            "processes": len(workers),
            "threads": len(list(Path(f"/proc/{self.pid}/task").iterdir())),
            "open files": len(list(Path(f"/proc/{self.pid}/fd").iterdir())),
            "database MB": (self.data / "coilcal.sqlite").stat().st_size / MEGA,
            "WAL MB": _size(self.data / "coilcal.sqlite-wal") / MEGA,
            "uploads": sum("uploads" in path.parts for path in files),
            "data files": len(files),
            "data MB": sum(map(_size, files)) / MEGA,
            "log MB": _size(log) / MEGA,
        }


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += map(int, task.read_text().split())
    return found


def _rss_MB(pid: int) -> float:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((float(line.split()[1]) / 1e3 for line in lines if line.startswith("VmRSS:")), 0.0)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


class Receiver(http.server.BaseHTTPRequestHandler):
    """Takes what webhooks send."""

    def do_POST(self) -> None:
        """Take it."""
        self.rfile.read(int(self.headers.get("content-length", 0)))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def main() -> None:
    """Soak, then tell what grew."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=25.0)
    parser.add_argument("--pause", type=float, default=0.05, help="seconds between two requests of a client")
    parser.add_argument(
        "--keep", type=int, default=10, help="jobs and streamed sessions that are not deleted"
    )
    options = parser.parse_args()
    os.environ[f"{ENVIRONMENT}WEBHOOK_NETWORKS"] = "127.0.0.0/8"
    receiver = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Receiver)
    threading.Thread(target=receiver.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        service = ServiceProcess(data)
        work = Work(service.url, Path(folder), options.keep)
        with httpx.Client(base_url=service.url) as http_client:
            http_client.post("/v1/webhooks", json={"url": f"http://127.0.0.1:{receiver.server_port}/"})
            schedule = {"rig_id": work.rig_id, "every_s": 60}
            http_client.post("/v1/schedules", json=schedule).raise_for_status()
        clients = [
            ("sessions", work.stream, options.pause),
            ("predictions", work.predict, options.pause),
            ("predictions", work.predict, options.pause),
            ("jobs", work.calibrate, options.pause),
            ("looks", work.look, 4 * options.pause),
            ("sessions to judge", work.new_session, 45.0),
            ("rounds of deletions", work.delete, 1.0),
        ]
        threads = [threading.Thread(target=work.repeat, args=client, daemon=True) for client in clients]
        for thread in threads:
            thread.start()
        usage, rows = Usage(service.process.pid, data), []
        while not rows or rows[-1]["min"] < options.minutes:
            time.sleep(min(NOTE_EVERY_S, 60.0 * options.minutes))
            rows.append(usage.row(work))
            print(json.dumps({name: round(value, 2) for name, value in rows[-1].items()}), flush=True)
        work.is_over.set()
        for thread in threads:
            thread.join(timeout=300)
        service.end()
        report(rows, work)


def report(rows: list[dict[str, float]], work: Work) -> None:
    """Some of the rows, and growth over the second half."""
    names = list(rows[0])
    print(" | ".join(names))
    for row in rows[:: max(1, len(rows) // ROWS)]:
        print(" | ".join(f"{row[name]:.4g}" for name in names))
    half = rows[len(rows) // 2 :]
    print("growth per 1000 operations over the second half:")
    thousands = np.array([row["operations"] for row in half]) / 1e3
    for name in names[2:]:
        slope = float(np.polyfit(thousands, [row[name] for row in half], 1)[0]) if len(half) > 1 else 0.0
        print(f"  {name:12} {slope:+.4g}")
    print("done: " + ", ".join(f"{n} {name}" for name, n in work.done.most_common()))
    print("refused: " + (", ".join(f"{n} x {words}" for words, n in work.faults.most_common()) or "nothing"))


if __name__ == "__main__":
    main()

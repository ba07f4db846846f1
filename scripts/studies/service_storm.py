"""Kills a service at random instants while clients stream readings to it, and looks for every reading that it has acknowledged.

    python -m scripts.studies.service_storm --kills 30 --clients 100 --seed 1

Each client has a session of its own and sends small batches; what is not acknowledged it sends again. In the end each session must hold all
that was acknowledged, once and in order, with the numbers that were sent. Ends with 1 where one does not.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import threading
import time
from pathlib import Path

import httpx

from estimator import load_rig, load_session
from estimator.client import Client
from estimator.rig.rig import Rig
from scripts.studies.service_process import ServiceProcess

RIG = Path("configs/paper_simulation.yaml")
LARGEST_BATCH = 10
LONGEST_LIFE_S = 3.0  # of a service between its start and its kill


class Streaming(threading.Thread):
    """A client that sends until it is told to end, and then until all is acknowledged."""

    def __init__(self, number: int, url: str, rig: Rig, pause_s: float) -> None:
        super().__init__(daemon=True)
        self.number, self.rig, self.pause_s = number, rig, pause_s
        self.random = random.Random(number)
        self.http = httpx.Client(base_url=url, timeout=30.0)
        with Client(url) as client:
            self.session_id = client.begin(rig, f"client {number}").id
        self.n_acknowledged = self.n_sent_again = 0
        self.is_over = threading.Event()
        self.fault = ""

    def value_T(self, sequence: int) -> float:
        """What the sensor shows: another number for each reading of each client."""
        return 1e-9 * (self.number * 1_000_000 + sequence)

    def run(self) -> None:
        """Send batches, each until it is acknowledged."""
        while not self.is_over.is_set():
            last = self.n_acknowledged + self.random.randint(1, LARGEST_BATCH)
            while self.n_acknowledged < last:
                self._send(last)
            time.sleep(self.random.uniform(0.0, 2.0 * self.pause_s))

    def _send(self, last: int) -> None:
        path = f"/v1/sessions/{self.session_id}/readings"
        body = b"".join(self._line(sequence) for sequence in range(self.n_acknowledged, last))
        try:
            answer = self.http.post(path, content=body, headers={"Content-Type": "application/x-ndjson"})
        except httpx.TransportError:
            self.n_sent_again += 1
            time.sleep(0.2)
            return
        if answer.status_code == 200:
            self.n_acknowledged = last
        elif answer.status_code in (429, 503):
            time.sleep(0.2)
        else:
            self.fault = answer.text[:300]
            self.n_acknowledged = last  # ends the batch; the check finds what is missing

    def _line(self, sequence: int) -> bytes:
        reading = {
            "sequence": sequence,
            "time_s": 0.01 * sequence,
            "current_A": {coil.name: 1.0 for coil in self.rig.coils},
            "motion": {mover.name: [0.0] * 6 for mover in self.rig.movers},
            "field_T": {self.rig.sensors[0].name: [self.value_T(sequence), 0.0, 0.0]},
        }
        return json.dumps(reading).encode() + b"\n"

    def wrong_in(self, data: Path) -> str:
        """What is wrong with the session on disk; nothing if it holds what was acknowledged."""
        if self.fault:
            return self.fault
        readings = load_session(data / "sessions" / f"{self.session_id}.zarr").observations
        values_T = readings.field_sensor_T[:, 0].tolist()
        if values_T != [self.value_T(sequence) for sequence in range(self.n_acknowledged)]:
            return f"{self.n_acknowledged} were acknowledged, {len(values_T)} are there, or others"
        return ""


def main() -> None:
    """Storm, then look."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--clients", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=200.0, help="readings a second of all clients together")
    arguments = parser.parse_args()
    instants = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        service = ServiceProcess(data)
        rig = load_rig(RIG)
        pause_s = arguments.clients * (1 + LARGEST_BATCH) / 2.0 / arguments.rate
        clients = [Streaming(number, service.url, rig, pause_s) for number in range(arguments.clients)]
        for client in clients:
            client.start()
        down_s = []
        for number in range(arguments.kills):
            time.sleep(instants.uniform(0.0, LONGEST_LIFE_S))
            service.kill()
            killed_s = time.monotonic()
            service = ServiceProcess(data, service.port)
            down_s.append(time.monotonic() - killed_s)
            n = sum(client.n_acknowledged for client in clients)
            print(f"kill {number + 1}: back after {down_s[-1]:.1f} s, {n} readings acknowledged", flush=True)
        for client in clients:
            client.is_over.set()
        for client in clients:
            client.join(timeout=120)
        service.end()
        wrong = {client.number: words for client in clients if (words := client.wrong_in(data))}
        n = sum(client.n_acknowledged for client in clients)
        n_again = sum(client.n_sent_again for client in clients)
        print(
            f"{arguments.kills} kills, {arguments.clients} clients: {n} readings acknowledged, {n_again} requests without an answer, "
            f"{len(wrong)} sessions wrong; back after {sum(down_s) / len(down_s):.1f} s"
        )
        for number, words in wrong.items():
            print(f"client {number}: {words}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()

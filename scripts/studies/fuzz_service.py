"""Asks a service whatever schemathesis makes of its schema, chained too, and ends with 1 if it fails or answers what it does not document.

    python -m scripts.studies.fuzz_service --seconds 300 --seed 7

The service holds a rig, a session and its calibration, so that requests find something. What the run found stands above the summary.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from estimator import SamplerSettings, Session, load_plan, load_rig, simulate
from estimator.client import Client
from scripts.studies.service_process import ServiceProcess

RIG, PLAN = Path("configs/paper_simulation.yaml"), Path("configs/plans/paper_grid.yaml")
QUICK = SamplerSettings(target_ess=100.0, largest_rhat=1.2, max_steps=1000)
EXCLUDED = (
    "positive_data_acceptance",  # a rig file is more than a text, and a session more than an id
    "unsupported_method",  # /v1/jobs/diagnose is a path and looks like an id to /v1/jobs/{job_id}, where GET finds that it is none
)
# Streams end with their job, and schemathesis makes no such bodies; tests do (test_bad_bodies).
LEFT_OUT = "(/events|/import-zip|/readings)$"


def main() -> None:
    """Start a service, ask it, and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=300)
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        service = ServiceProcess(Path(folder) / "data")
        try:
            rig = load_rig(RIG)
            with Client(service.url) as client:
                client.calibrate(
                    Session(rig, simulate(rig, load_plan(PLAN, rig), {}, seed=1), "simulated"), settings=QUICK
                )
            call = ["run", f"{service.url}/v1/openapi.json", "--seed", str(arguments.seed)]
            call += ["--max-time", str(arguments.seconds), "--continue-on-failure", "--no-color"]
            call += ["--exclude-checks", ",".join(EXCLUDED), "--exclude-path-regex", LEFT_OUT]
            ended = subprocess.run(
                [str(Path(sys.executable).with_name("schemathesis")), *call], check=False, cwd=folder
            )
            with Client(service.url) as client:
                print("the service answers:", client.request("GET", "/v1/state").json())
            log = (Path(folder) / "data.log").read_text(encoding="utf-8")
            print("tracebacks in its log:", log.count('"traceback"'))
        finally:
            service.end()
    sys.exit(ended.returncode)


if __name__ == "__main__":
    main()

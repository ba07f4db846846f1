"""Starts the service with the sessions of the demo, both at work, and shows its page; `make demo-service` runs it.

Everything is kept in `demo/service`, so that a second start finds the results of the first. Ctrl-C ends it.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from estimator import load_session
from estimator.client import Client

DEMO = Path("demo")
JOBS = {"calibrate": "session.zarr", "diagnose": "flawed.zarr"}
PORT = 8765
COMMAND = "from estimator.cli.main import main; main()"


def main() -> None:
    serve = [
        sys.executable,
        "-c",
        COMMAND,
        "serve",
        "--data",
        str(DEMO / "service"),
        "--port",
        str(PORT),
        "--open",
    ]
    service = subprocess.Popen(serve)
    try:
        with Client(f"http://127.0.0.1:{PORT}", attempts=60) as client:
            for kind, session in JOBS.items():
                session_id = client.upload(load_session(DEMO / session))
                job = {"session_id": session_id, "seed": 1}
                # The key makes a second start ask for the same job, not for another.
                client.request(
                    "POST", f"/v1/jobs/{kind}", json=job, headers={"Idempotency-Key": f"demo-{kind}"}
                )
        service.wait()
    except KeyboardInterrupt:
        service.wait()
    finally:
        service.terminate()


if __name__ == "__main__":
    main()

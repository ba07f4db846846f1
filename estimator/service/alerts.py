"""Alerts: a command of the settings runs for every conclusion that needs action, as that of `coilcal recalibrate` does.

The worker writes a file for each before the registry counts it as delivered. The service runs the command and removes the file, so a
kill at any instant runs the command again and forgets nothing. No request names a command.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from estimator.errors import CorruptStore
from estimator.json_files import read_json
from estimator.recalibration.alerts import run_command
from estimator.recalibration.log import Entry
from estimator.store.files import write_text

ALERTS = "alerts"  # folder beside that of the jobs
LOOK_EVERY_S = 1.0
log = logging.getLogger("coilcal.service")


def leave_alert(folder: Path, rig_name: str, entry: Entry) -> None:
    """Leave a conclusion for the command.

    Args:
        folder: Where they wait.
        rig_name: Name of the rig that the registry is of.
        entry: The conclusion.
    """
    folder.mkdir(parents=True, exist_ok=True)
    message = {"rig": rig_name, **asdict(entry), "session": Path(entry.session).stem}
    name = f"{entry.concluded}-{entry.hash[:16]}.json"  # in the order in which they were drawn
    write_text(folder / name, json.dumps(message, allow_nan=False) + "\n")


def run_alerts(command: str, folder: Path, is_ending: Callable[[], bool] = lambda: False) -> None:
    """Run the command for each conclusion that waits; one that fails is logged and not tried again.

    Args:
        command: The command; none where it is empty.
        folder: Where conclusions wait for it.
        is_ending: Whether the service ends, which leaves the others for its next start.
    """
    for path in sorted(folder.glob("*.json")) if command else ():
        if is_ending():
            return
        try:
            fault = run_command(command, read_json(path, fault=CorruptStore))
        except CorruptStore as error:
            fault = str(error)
        path.unlink()
        if fault is None:
            log.info("alert", extra={"alert": path.stem})
        else:
            log.error("alert failed", extra={"alert": path.stem, "fault": fault})

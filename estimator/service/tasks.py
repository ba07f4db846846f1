"""The three kinds of job that build on several calibrations or prepare the next: recalibration, batch, design.

Each may be done again after a kill: the registry, the folder of a batch and the result of a design are their own state.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from estimator.recalibration.registry import Entry
from estimator.rig.rig import Rig
from estimator.service.alerts import ALERTS, leave_alert
from estimator.store.files import write_text

CALIBRATION, REPORT = "calibration", "report.html"
CONCLUSION, BATCH, DESIGN = "conclusion.json", "batch.json", "design.json"
INBOX, FITS, RIG = "inbox", "fits", "rig.yaml"
LOOK_EVERY_S = 1.0

Tell = Callable[[str, Mapping[str, Any]], None]


def recalibrate_job(job: Mapping[str, Any], folder: Path, session_path: Path, tell: Tell) -> dict[str, Any]:
    """Judge a session against the current version of its rig's registry; a version that is made is the job's calibration too."""
    from estimator.inference.ensemble import SamplerSettings
    from estimator.recalibration.alerts import calls_for_action
    from estimator.recalibration.recalibrate import recalibrate
    from estimator.recalibration.registry import HISTORY, Registry, RegistryBusy
    from estimator.store.session import load_session

    session, options, registry = load_session(session_path), job["options"], Registry(job["registry"])
    rig = rig_of(job) or session.rig
    inbox = folder / INBOX
    inbox.mkdir(exist_ok=True)
    arrived = inbox / session_path.name
    if not arrived.is_symlink():
        arrived.symlink_to(session_path)

    def alert(entry: Entry) -> None:
        if job["has_alerts"] and calls_for_action(entry):
            leave_alert(folder.parent.parent / ALERTS, rig.name, entry)

    tell("judging the session", {})
    while True:
        try:
            recalibrate(
                rig,
                inbox,
                registry.folder,
                seed=options["seed"],
                settings=SamplerSettings(**options["settings"]),
                on_entry=alert,
            )
            break
        except RegistryBusy:
            tell("waiting for another recalibration of this rig", {})
            time.sleep(LOOK_EVERY_S)
    entry = next(entry for entry in reversed(registry.entries()) if entry.hash == session.hash)
    content = {**asdict(entry), "session": session_path.stem}
    write_text(folder / CONCLUSION, json.dumps(content, indent=2, allow_nan=False) + "\n")
    page = (registry.folder / HISTORY).read_text(encoding="utf-8")
    write_text(folder / REPORT, page.replace(str(registry.folder), f"registry of {rig.name}"))
    if entry.made is not None:
        registry.calibration(entry.made).save(folder / CALIBRATION)
    return {
        "conclusion": entry.conclusion,
        "has_calibration": entry.made is not None,
        "rig_name": rig.name,
    }


def batch_job(job: Mapping[str, Any], folder: Path, _: Path, tell: Tell) -> dict[str, Any]:
    """Fit many sessions under several hypotheses, stacked on the batch axis, in this process."""
    from estimator.batching import batch
    from estimator.batching.page import overview
    from estimator.inference.ensemble import SamplerSettings

    options = job["options"]
    if job["rig"] is not None:
        write_text(folder / RIG, job["rig"])
    result = batch(
        job["sessions"],
        out=folder / FITS,
        rig=None if job["rig"] is None else folder / RIG,
        hypotheses=options["hypotheses"],
        is_each_coil=options["is_each_coil"],
        has_posterior=options["has_posterior"],
        as_described=options.get("as_described", False),
        seed=options["seed"],
        settings=SamplerSettings(**options["settings"]),
        workers=0,
        tell=lambda done, total, words: tell(words, {"done": done, "total": total}),
    )
    table = json.loads(result.table().to_json(orient="records", double_precision=15))
    fits = [{**fit, "session": Path(fit["session"]).stem} for fit in table]
    failed = {Path(what).stem: why for what, why in result.failed.items()}
    write_text(folder / BATCH, json.dumps({"fits": fits, "failed": failed}, indent=2, allow_nan=False) + "\n")
    page = overview(result, command_of(job, "batch"))
    write_text(folder / REPORT, page.replace(str(folder / FITS), f"job {job['id']}"))
    return {"n_fits": len(fits), "n_failed": len(failed)}


def design_job(job: Mapping[str, Any], folder: Path, session_path: Path, tell: Tell) -> dict[str, Any]:
    """Propose the next readings, with a plan for `coilcal acquire`."""
    from estimator.diagnosis.next_readings.design import design
    from estimator.store.session import load_session

    tell("choosing the next readings", {})
    proposal = design(load_session(session_path), rig=rig_of(job), **job["options"])
    write_text(folder / DESIGN, json.dumps(proposal.to_json(), indent=2, allow_nan=False) + "\n")
    return {"goal": proposal.goal}


def rig_of(job: Mapping[str, Any]) -> Rig | None:
    """The rig that a job was given; None for that of its session."""
    from estimator.rig_files.read import rig_from_text

    return None if job["rig"] is None else rig_from_text(job["rig"], "rig of the job")


def command_of(job: Mapping[str, Any], name: str) -> str:
    """The command that would do the same, for the page."""
    options = job["options"]
    flags = " --as-described" if options.get("as_described") else ""
    flags += "" if options.get("has_corrections", True) else " --no-corrections"
    return f"coilcal {name} SESSION --seed {options['seed']}{flags}   (job {job['id']} of coilcal serve)"

"""The five kinds of job, and where each leaves what it has found.

Each may be done again after a kill: the chain of a calibration, the fits of a diagnosis or a batch, and a registry are their own state.
Workers import this module without the web libraries, so those of another cluster need `coilcal[batch]` only.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimator.errors import CorruptStore
from estimator.inference.ensemble import SamplerSettings
from estimator.json_files import read_json
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.service.alerts import ALERTS, leave_alert
from estimator.store.files import write_text
from estimator.store.session import Session, load_session

if TYPE_CHECKING:
    from estimator.calibration.calibrate import Stage
    from estimator.recalibration.log import Entry

CALIBRATION, DIAGNOSIS, REPORT = "calibration", "diagnosis", "report.html"
PANELS = f"{DIAGNOSIS}/panels.json"
CONCLUSION, BATCH, DESIGN = "conclusion.json", "batch.json", "design.json"
INBOX, FITS, RIG = "inbox", "fits", "rig.yaml"
LOOK_EVERY_S = 1.0


Tell = Callable[[str, Mapping[str, Any]], None]


@dataclass(frozen=True)
class AssignedJob:
    """A job with its folder.

    Attributes:
        content: Content of its `job.json`.
        folder: The folder.
        session_path: Folder of its session.
        tell: Reports progress, in words and numbers; raises where the job must end.
    """

    content: Mapping[str, Any]
    folder: Path
    session_path: Path
    tell: Tell

    @property
    def options(self) -> Mapping[str, Any]:
        """What was asked for."""
        return self.content["options"]

    @property
    def arguments(self) -> dict[str, Any]:
        """What was asked for, as the Python API takes it."""
        settings = self.options.get("settings")
        return {**self.options, **({} if settings is None else {"settings": SamplerSettings(**settings)})}

    @property
    def rig(self) -> Rig | None:
        """The rig that was given; None for that of the session."""
        text = self.content["rig"]
        return None if text is None else rig_from_text(text, "rig of the job")

    def session(self) -> Session:
        """The session."""
        return load_session(self.session_path)

    def command(self, name: str) -> str:
        """The command that would do the same, for the page."""
        flags = " --as-described" if self.options.get("as_described") else ""
        flags += "" if self.options.get("has_corrections", True) else " --no-corrections"
        job = f"job {self.content['id']} of coilcal serve"
        return f"coilcal {name} SESSION --seed {self.options['seed']}{flags}   ({job})"

    def write(self, name: str, content: Mapping[str, Any]) -> None:
        """Write a JSON file of the folder, whole or not at all."""
        write_text(self.folder / name, json.dumps(content, indent=2, allow_nan=False) + "\n")


def calibrate_job(job: AssignedJob) -> dict[str, Any]:
    """Point estimate, posterior, model and page of a session."""
    from estimator.calibration.calibrate import calibrate
    from estimator.calibration.report import calibration_report
    from estimator.calibration.result import Calibration

    out = job.folder / CALIBRATION
    if _is_converged(out):  # a kill came between the posterior and the page
        calibration = Calibration.load(out)
    else:
        calibration = calibrate(
            job.session(),
            job.rig,
            out=out,
            on_stage=lambda stage: job.tell(stage.name, _numbers_of(stage)),
            **job.arguments,
        )
    job.tell("page", {})
    write_text(out / REPORT, calibration_report(calibration, job.command("calibrate")))
    summary = calibration.summary()
    return {
        "is_converged": summary["is_converged"],
        "verdict": summary["quality"]["verdict"],
        "has_calibration": True,
        "rig_name": calibration.rig.name,
    }


def diagnose_job(job: AssignedJob) -> dict[str, Any]:
    """What the model of a session gets wrong, named, and the rig extended by it."""
    from estimator.diagnosis.diagnose import diagnose
    from estimator.diagnosis.limits import Limits
    from estimator.diagnosis.panels import panels, panels_text
    from estimator.diagnosis.report import write_reports
    from estimator.diagnosis.result import DIAGNOSIS as DIAGNOSIS_FILE

    out = job.folder / DIAGNOSIS
    # A kill came before the page, which needs fits that are no longer remembered.
    if (out / DIAGNOSIS_FILE).exists():
        shutil.rmtree(out)
    given = {name: value for name, value in job.arguments.items() if value is not None}
    limits = Limits(**{name: given.pop(name) for name in ("most_causes", "minutes") if name in given})
    diagnosis = diagnose(
        job.session(),
        job.rig,
        out=out,
        limits=limits,
        on_stage=lambda words: job.tell(words, {}),
        on_progress=lambda at: job.tell(at.what, {"n_fitted": at.n_fitted, "most": at.most}),
        **given,
    )
    job.tell("page", {})
    write_text(job.folder / PANELS, panels_text(panels(diagnosis)))
    write_reports(diagnosis, out, job.command("diagnose"))
    return {
        "verdict": str(diagnosis.verdict),
        "has_calibration": diagnosis.posterior is not None,
        "rig_name": diagnosis.extended_rig.name,
    }


def recalibrate_job(job: AssignedJob) -> dict[str, Any]:
    """Judge a session against the current version of its rig's registry; a version that is made is the job's calibration too."""
    from estimator.recalibration.alerts import calls_for_action
    from estimator.recalibration.recalibrate import recalibrate
    from estimator.recalibration.registry import HISTORY, Registry, RegistryBusy

    session, registry, inbox = job.session(), Registry(job.content["registry"]), job.folder / INBOX
    rig = job.rig or session.rig
    inbox.mkdir(exist_ok=True)
    arrived = inbox / job.session_path.name
    if not arrived.is_symlink():
        arrived.symlink_to(job.session_path)

    def alert(entry: Entry) -> None:
        if job.content["has_alerts"] and calls_for_action(entry):
            leave_alert(job.folder.parent.parent / ALERTS, rig.name, entry)

    job.tell("judging the session", {})
    while True:
        try:
            recalibrate(rig, inbox, registry.folder, on_entry=alert, **job.arguments)
            break
        except RegistryBusy:
            job.tell("waiting for another recalibration of this rig", {})
            time.sleep(LOOK_EVERY_S)
    entry = next(entry for entry in reversed(registry.entries()) if entry.hash == session.hash)
    job.write(CONCLUSION, {**asdict(entry), "session": job.session_path.stem})
    page = (registry.folder / HISTORY).read_text(encoding="utf-8")
    write_text(job.folder / REPORT, page.replace(str(registry.folder), f"registry of {rig.name}"))
    if entry.made is not None:
        registry.calibration(entry.made).save(job.folder / CALIBRATION)
    return {"conclusion": entry.conclusion, "has_calibration": entry.made is not None, "rig_name": rig.name}


def batch_job(job: AssignedJob) -> dict[str, Any]:
    """Fit many sessions under several hypotheses, stacked on the batch axis, in this process."""
    from estimator.batching import batch
    from estimator.batching.page import overview

    out, rig = job.folder / FITS, job.folder / RIG
    if job.content["rig"] is not None:
        write_text(rig, job.content["rig"])
    result = batch(
        job.content["sessions"],
        out=out,
        rig=None if job.content["rig"] is None else rig,
        workers=0,
        tell=lambda done, total, words: job.tell(words, {"done": done, "total": total}),
        **job.arguments,
    )
    table = json.loads(result.table().to_json(orient="records", double_precision=15))
    fits = [{**fit, "session": Path(fit["session"]).stem} for fit in table]
    failed = {Path(what).stem: why for what, why in result.failed.items()}
    job.write(BATCH, {"fits": fits, "failed": failed})
    page = overview(result, job.command("batch"))
    write_text(job.folder / REPORT, page.replace(str(out), f"job {job.content['id']}"))
    return {"n_fits": len(fits), "n_failed": len(failed)}


def design_job(job: AssignedJob) -> dict[str, Any]:
    """Propose the next readings, with a plan for `coilcal acquire`."""
    from estimator.diagnosis.next_readings.design import design

    job.tell("choosing the next readings", {})
    proposal = design(job.session(), rig=job.rig, **job.arguments)
    job.write(DESIGN, proposal.to_json())
    return {"goal": proposal.goal}


@dataclass(frozen=True)
class Task:
    """A kind of job.

    Attributes:
        work: What a worker does; it may be done again after a kill.
        result: JSON file with what was found, in the folder of the job.
        report: Page; None where there is none.
        calibration: Folder of the calibration, where one was made.
    """

    work: Callable[[AssignedJob], dict[str, Any]]
    result: str
    report: str | None = REPORT
    calibration: str = CALIBRATION


TASKS: Mapping[str, Task] = {
    "calibrate": Task(calibrate_job, f"{CALIBRATION}/summary.json", f"{CALIBRATION}/{REPORT}"),
    "diagnose": Task(
        diagnose_job, f"{DIAGNOSIS}/diagnosis.json", f"{DIAGNOSIS}/{REPORT}", f"{DIAGNOSIS}/{CALIBRATION}"
    ),
    "recalibrate": Task(recalibrate_job, CONCLUSION),
    "batch": Task(batch_job, BATCH),
    "design": Task(design_job, DESIGN, None),
}


def _numbers_of(stage: Stage) -> dict[str, Any]:
    """How far sampling is; nothing in other stages."""
    names = ("step", "smallest_ess", "target_ess", "largest_rhat")
    return {} if stage.sampling is None else {name: getattr(stage.sampling, name) for name in names}


def _is_converged(out: Path) -> bool:
    from estimator.calibration.files import SUMMARY_FILE

    summary = out / SUMMARY_FILE
    return summary.exists() and bool(read_json(summary, fault=CorruptStore)["is_converged"])

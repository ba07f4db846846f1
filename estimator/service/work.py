"""What a worker does for a job, in the job's folder: every step can be made again after a kill, and ends with the same files.

Workers import this module without the web libraries, so those of another cluster need `coilcal[batch]` only.
"""

from __future__ import annotations

import fcntl
import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from estimator.errors import CoilcalError, CorruptStore
from estimator.json_files import read_json
from estimator.service.tasks import (
    BATCH,
    CALIBRATION,
    CONCLUSION,
    DESIGN,
    REPORT,
    Tell,
    batch_job,
    command_of,
    design_job,
    recalibrate_job,
    rig_of,
)
from estimator.store.files import write_text

JOB, RESULT, PROGRESS, LOCK = "job.json", "result.json", "progress.jsonl", "lock"
DIAGNOSIS, PANELS = "diagnosis", "panels.json"
PROGRESS_EVERY_S = 0.2

STOP = "stop"  # a file that says that the job must end, for workers that cannot be replaced


class Stopped(BaseException):
    """The job was cancelled, or its time is over; no `except Exception` on the way holds this up."""


def run_job(folder: str, session: str) -> None:
    """Do the job of a folder, or what is left of it, and write `result.json`, which marks it as done.

    Args:
        folder: The job's folder with `job.json`.
        session: Folder of its session.
    """
    torch.set_num_threads(1)
    path = Path(folder)
    with _only_worker(path):
        if (path / RESULT).exists():
            return
        if (path / STOP).exists():
            return
        job = read_json(path / JOB, fault=CorruptStore)
        tell = _teller(path)
        try:
            result = {"state": "done", "fault": None, **WORK[job["kind"]](job, path, Path(session), tell)}
        except Stopped:
            return
        except CoilcalError as error:
            result = {"state": "failed", "fault": str(error)}
        write_text(path / RESULT, json.dumps(result, indent=2, allow_nan=False) + "\n")


def _calibrate(job: Mapping[str, Any], folder: Path, session_path: Path, tell: Tell) -> dict[str, Any]:
    from estimator.calibration.calibrate import Stage, calibrate
    from estimator.calibration.report import calibration_report
    from estimator.calibration.result import Calibration
    from estimator.inference.ensemble import SamplerSettings
    from estimator.store.session import load_session

    options = job["options"]
    out = folder / CALIBRATION

    def on_stage(stage: Stage) -> None:
        sampling = stage.sampling
        numbers = (
            {}
            if sampling is None
            else {
                "step": sampling.step,
                "smallest_ess": sampling.smallest_ess,
                "target_ess": sampling.target_ess,
                "largest_rhat": sampling.largest_rhat,
            }
        )
        tell(stage.name, numbers)

    if _is_converged(out):  # a kill came between the posterior and the page
        calibration = Calibration.load(out)
    else:
        calibration = calibrate(
            load_session(session_path),
            rig_of(job),
            out=out,
            seed=options["seed"],
            settings=SamplerSettings(**options["settings"]),
            has_integer_counts=options["has_integer_counts"],
            as_described=options.get("as_described", False),  # jobs of version 0.2 do not say it
            on_stage=on_stage,
        )
    tell("page", {})
    write_text(out / REPORT, calibration_report(calibration, command_of(job, "calibrate")))
    summary = calibration.summary()
    return {
        "is_converged": summary["is_converged"],
        "verdict": summary["quality"]["verdict"],
        "has_calibration": True,
        "rig_name": calibration.rig.name,
    }


def _diagnose(job: Mapping[str, Any], folder: Path, session_path: Path, tell: Tell) -> dict[str, Any]:
    from estimator.diagnosis.diagnose import diagnose
    from estimator.diagnosis.limits import Limits
    from estimator.diagnosis.panels import panels, panels_text
    from estimator.diagnosis.progress import Progress
    from estimator.diagnosis.report import write_reports
    from estimator.diagnosis.result import DIAGNOSIS as DIAGNOSIS_FILE
    from estimator.store.session import load_session

    options = job["options"]
    out = folder / DIAGNOSIS
    # A kill came before the page, which needs fits that are no longer remembered.
    if (out / DIAGNOSIS_FILE).exists():
        shutil.rmtree(out)
    limits = {name: options[name] for name in ("most_causes", "minutes") if options[name] is not None}
    readings = {name: options[name] for name in ("most_readings",) if options[name] is not None}

    def on_progress(progress: Progress) -> None:
        tell(progress.what, {"n_fitted": progress.n_fitted, "most": progress.most})

    diagnosis = diagnose(
        load_session(session_path),
        rig_of(job),
        out=out,
        seed=options["seed"],
        has_posterior=options["has_posterior"],
        has_corrections=options.get("has_corrections", True),
        limits=Limits(**limits),
        **readings,
        on_stage=lambda words: tell(words, {}),
        on_progress=on_progress,
    )
    tell("page", {})
    write_text(out / PANELS, panels_text(panels(diagnosis)))
    write_reports(diagnosis, out, command_of(job, "diagnose"))
    return {
        "verdict": str(diagnosis.verdict),
        "has_calibration": diagnosis.posterior is not None,
        "rig_name": diagnosis.extended_rig.name,
    }


WORK: Mapping[str, Callable[[Mapping[str, Any], Path, Path, Tell], dict[str, Any]]] = {
    "calibrate": _calibrate,
    "diagnose": _diagnose,
    "recalibrate": recalibrate_job,
    "batch": batch_job,
    "design": design_job,
}


def calibration_folder(kind: str, folder: Path) -> Path:
    """Folder in which a job of a kind leaves its calibration."""
    return folder / DIAGNOSIS / CALIBRATION if kind == "diagnose" else folder / CALIBRATION


def result_file(kind: str, folder: Path) -> Path:
    """JSON file in which a job of a kind leaves what it has found."""
    names = {
        "calibrate": f"{CALIBRATION}/summary.json",
        "diagnose": f"{DIAGNOSIS}/diagnosis.json",
        "recalibrate": CONCLUSION,
        "batch": BATCH,
        "design": DESIGN,
    }
    return folder / names[kind]


def report_file(kind: str, folder: Path) -> Path:
    """File in which a job of a kind leaves its page; a design has none."""
    names = {"calibrate": f"{CALIBRATION}/{REPORT}", "diagnose": f"{DIAGNOSIS}/{REPORT}"}
    return folder / names.get(kind, REPORT)


def _is_converged(out: Path) -> bool:
    from estimator.calibration.files import SUMMARY_FILE

    summary = out / SUMMARY_FILE
    return summary.exists() and bool(read_json(summary, fault=CorruptStore)["is_converged"])


def _teller(folder: Path) -> Tell:
    """Appends lines of progress to a file; new numbers of the same kind come five times a second at most. Ends a job that must end."""
    last_kind: tuple[str, ...] = ()
    last_s = 0.0

    def tell(words: str, numbers: Mapping[str, Any]) -> None:
        nonlocal last_kind, last_s
        if (folder / STOP).exists():
            raise Stopped
        kind = (words, *numbers)
        if kind == last_kind and time.monotonic() - last_s < PROGRESS_EVERY_S:
            return
        last_kind, last_s = kind, time.monotonic()
        line = {"time_s": round(time.time(), 3), "words": words, **_finite(numbers)}
        with (folder / PROGRESS).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    return tell


def _finite(numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and value - value != 0.0 else value
        for name, value in numbers.items()
    }


@contextmanager
def _only_worker(folder: Path) -> Iterator[None]:
    """Wait for another worker at the same job, such as one that has not noticed yet that its service was killed."""
    with (folder / LOCK).open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield

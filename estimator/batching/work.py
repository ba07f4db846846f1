"""The work of a batch worker: fit a stack of jobs, or sample the posterior of one. Results are written to disk atomically."""

from __future__ import annotations

import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from estimator.batching.jobs import Job, jobs_of, readings_and_rig, rig_to_fit
from estimator.batching.stacked import stacked_fits
from estimator.calibration.calibrate import calibrate, versions
from estimator.calibration.files import CALIBRATION, SUMMARY_FILE
from estimator.code_version import code_version
from estimator.diagnosis import effort
from estimator.diagnosis.fitting import Fit
from estimator.errors import CoilcalError, CorruptStore, InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.json_files import read_json, sealed
from estimator.model.preflight import check_precision, check_readings
from estimator.readings.metrics import HALF_WIDTH_90, error_metrics
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.files import write_text
from estimator.store.session import load_session
from estimator.store.staging import staged

RESULT_FILE, CALIBRATION_FOLDER = "result.json", "calibration"


def describe(*arguments: Any) -> tuple[list[Job], dict[str, str]] | str:
    """The jobs of one session with the reasons against others, or why there are none, in a sentence; arguments as of `jobs_of`."""
    try:
        return jobs_of(*arguments)
    except CoilcalError as error:
        return str(error)


def fit(stack: list[Job], folder: str) -> dict[str, str]:
    """Fit jobs of the same rig and settings together and write a result folder for each.

    Returns: The reason for each failed job, by its name, in a sentence; the other jobs are finished all the same.
    """
    torch.set_num_threads(1)
    failed: dict[str, str] = {}
    ready: list[tuple[Job, Observations, Rig]] = []
    for job in stack:
        try:
            session, rig = readings_and_rig(job, load_session(job.session))
            check_readings(rig, session.observations, session.source)
            if job.precision != "double":
                check_precision(rig, session.observations.calibration)
            readings = session.observations
            ready.append((job, readings, rig_to_fit(job, rig, readings.calibration)))
        except Exception as error:
            failed[job.name] = _words(error)
    for (job, observations, _), outcome in zip(ready, _fits(ready), strict=True):
        try:
            if isinstance(outcome, Exception):
                raise outcome
            _write(Path(folder) / job.name, _result(job, outcome, observations))
        except Exception as error:
            failed[job.name] = _words(error)
    return failed


def _fits(ready: list[tuple[Job, Observations, Rig]]) -> list[Fit | Exception]:
    """Fit all jobs together, or one by one if that fails: a single session of absurd numbers spoils a stack."""
    if not ready:
        return []
    job, _, rig = ready[0]
    try:
        fits = stacked_fits(
            rig,
            [observations.calibration for _, observations, _ in ready],
            [job.seed for job, _, _ in ready],
            effort.MORE_STARTS,
            job.device,
            job.precision,
        )
    except Exception as error:
        return [error] if len(ready) == 1 else [_fits([ready_job])[0] for ready_job in ready]
    return [Fit(posterior, optimum) for posterior, optimum in fits]


def sampled(job: Job, folder: str, settings: SamplerSettings) -> str | None:
    """Sample the posterior of a fitted job; a sampling that was interrupted, or that ended before the present targets, is continued.

    Returns: Why there is no posterior, in a sentence; None if there is one.
    """
    torch.set_num_threads(1)
    finished = Path(folder) / job.name / CALIBRATION_FOLDER
    try:
        session, rig = readings_and_rig(job, load_session(job.session))
        # Waits for another worker at the same job: a worker whose scheduler was lost keeps working.
        with staged(finished, overwrite=True, made=CALIBRATION, goes_on=True, waits=True) as unfinished:
            if is_enough(finished, settings):  # finished by a worker that was thought to be lost
                shutil.rmtree(unfinished, ignore_errors=True)
                return None
            if finished.exists() and not unfinished.exists():
                copy = unfinished.with_name("copy")
                shutil.rmtree(copy, ignore_errors=True)
                shutil.copytree(finished, copy)
                copy.rename(unfinished)
            if not is_enough(unfinished, settings):
                (unfinished / SUMMARY_FILE).unlink(missing_ok=True)
                calibrate(
                    session,
                    rig,
                    out=unfinished,
                    seed=job.seed,
                    settings=settings,
                    as_described=job.as_described,
                    device=job.device,
                    precision=job.precision,
                )
    except CoilcalError as error:
        return str(error)
    return None


def is_enough(posterior: Path, settings: SamplerSettings) -> bool:
    """Whether a posterior meets the targets or has taken all allowed steps."""
    if not (posterior / SUMMARY_FILE).exists():
        return False
    sampling = read_json(posterior / SUMMARY_FILE, fault=CorruptStore)["sampling"]
    ess, rhat = sampling["smallest_ess"], sampling["largest_rhat"]
    has_met = ess >= settings.target_ess and rhat is not None and rhat <= settings.largest_rhat
    return bool(has_met or sampling["steps"] >= settings.max_steps)


def _words(error: Exception) -> str:
    return str(error) if isinstance(error, CoilcalError) else f"{type(error).__name__}: {error}"


def _result(job: Job, fit: Fit, observations: Observations) -> dict[str, Any]:
    parameters = {}
    for parameter in fit.rig.free:
        value, sd = float(fit.values[parameter.name]), fit.value_sd(parameter.name)
        ci90 = [value - HALF_WIDTH_90 * sd, value + HALF_WIDTH_90 * sd]
        parameters[parameter.name] = {"median": value, "sd": sd, "ci90": ci90, "unit": parameter.unit}
    rmse = {}
    for role, part in (("calibration", observations.calibration), ("validation", observations.validation)):
        rmse[role] = _vector_rms_T(fit, part) if len(part) else None
    return {
        **asdict(replace(job, rig=None)),  # a rig has limits that JSON has no number for
        "rig": None if job.rig is None else job.rig.hash,
        "parameters": parameters,
        "log_evidence": fit.log_evidence,
        "is_converged": bool(fit.optimum.is_converged[0]),
        "vector_rmse_T": rmse,
        "versions": versions(),
        "code": code_version(),
    }


def _vector_rms_T(fit: Fit, observations: Observations) -> float:
    with torch.no_grad():
        predicted_T = fit.model_of(observations).predict(fit.values).expand(len(observations), 3)
    return error_metrics(observations.field_sensor_T.numpy(), predicted_T.numpy()).vector_T


def _write(folder: Path, result: dict[str, Any]) -> None:
    """Write a result folder under a temporary name and rename it; an existing one stays, because it holds the same result."""
    if (folder / RESULT_FILE).exists():
        return
    try:
        with staged(folder, waits=True) as unfinished:
            unfinished.mkdir()
            write_text(unfinished / RESULT_FILE, sealed(result, indent=2))
    except InvalidInput:
        if not (folder / RESULT_FILE).exists():  # else another attempt was faster
            raise

"""What a worker does: fit a stack of jobs, or sample the posterior of one. Results go to disk whole or not at all."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from estimator.batching.jobs import Job, jobs_of, readings_and_rig
from estimator.calibrate import calibrate, versions
from estimator.calibration import SUMMARY, write_text
from estimator.chain import Chain
from estimator.diagnosis.fitting import Fit
from estimator.errors import CoilcalError
from estimator.inference.ensemble import SamplerSettings
from estimator.inference.stacked import stacked_fits
from estimator.metrics import errors
from estimator.preflight import check_readings
from estimator.records import Observations
from estimator.rig import Rig
from estimator.store.session import load_session, replace_folder

RESULT, POSTERIOR = "result.json", "calibration"
MORE_STARTS = 3
HALF_WIDTH_90 = 1.644854


def describe(
    path: str, rig_text: str, hypotheses: tuple[str, ...], is_each_coil: bool, seed: int
) -> list[Job] | str:
    """The jobs of one session, or the sentence that says why there are none."""
    try:
        return jobs_of(path, rig_text, hypotheses, is_each_coil, seed)
    except CoilcalError as error:
        return str(error)


def fit(stack: list[Job], folder: str) -> dict[str, str]:
    """Fit jobs of the same rig and settings together and write one result folder each.

    Returns: For each job that failed, by its name, the sentence that says why.
    """
    torch.set_num_threads(1)
    failed: dict[str, str] = {}
    ready: list[tuple[Job, Observations, Rig]] = []
    for job in stack:
        try:
            session, rig = readings_and_rig(job, load_session(job.session))
            check_readings(rig, session.observations, session.source)
            ready.append((job, session.observations, rig))
        except CoilcalError as error:
            failed[job.name] = str(error)
    if not ready:
        return failed
    fits = stacked_fits(
        ready[0][2],
        [observations.calibration for _, observations, _ in ready],
        [job.seed for job, _, _ in ready],
        MORE_STARTS,
    )
    for (job, observations, _), (posterior, polished) in zip(ready, fits, strict=True):
        record = _record(job, Fit(posterior, polished), observations)
        _write(Path(folder) / job.name, record)
    return failed


def sampled(job: Job, folder: str, settings: SamplerSettings) -> str | None:
    """Sample the posterior of a job that was fitted; a sampling that was cut off goes on where it ended.

    Returns: The sentence that says why there is none, or None.
    """
    torch.set_num_threads(1)
    place = Path(folder) / job.name
    unfinished = place / f".{POSTERIOR}.unfinished"
    try:
        session, rig = readings_and_rig(job, load_session(job.session))
        if not (unfinished / SUMMARY).exists():
            calibrate(session, rig, out=unfinished, seed=job.seed, settings=settings)
    except CoilcalError as error:
        return str(error)
    replace_folder(unfinished, place / POSTERIOR)
    return None


def _record(job: Job, fit: Fit, observations: Observations) -> dict[str, Any]:
    parameters = {}
    for parameter in fit.rig.free:
        value, sd = float(fit.values[parameter.name]), fit.value_sd(parameter.name)
        ci90 = [value - HALF_WIDTH_90 * sd, value + HALF_WIDTH_90 * sd]
        parameters[parameter.name] = {"median": value, "sd": sd, "ci90": ci90, "unit": parameter.unit}
    rmse = {}
    for role, some in (("calibration", observations.calibration), ("validation", observations.validation)):
        rmse[role] = _vector_T(fit, some) if len(some) else None
    return {
        **asdict(job),
        "parameters": parameters,
        "log_evidence": fit.log_evidence,
        "is_converged": bool(fit.polished.is_converged[0]),
        "vector_rmse_T": rmse,
        "versions": versions(),
    }


def _vector_T(fit: Fit, observations: Observations) -> float:
    with torch.no_grad():
        predicted_T = Chain.build(fit.rig, observations).predict(fit.values).expand(len(observations), 3)
    return errors(observations.field_sensor_T.numpy(), predicted_T.numpy()).vector_T


def _write(place: Path, record: dict[str, Any]) -> None:
    """A result folder, written under another name and renamed; one that is there already stays."""
    if (place / RESULT).exists():
        return
    unfinished = place.with_name(f".{place.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    write_text(unfinished / RESULT, json.dumps(record, indent=2, allow_nan=False) + "\n")
    replace_folder(unfinished, place)

"""What a worker does: fit a stack of jobs, or sample the posterior of one. Results go to disk whole or not at all."""

from __future__ import annotations

import json
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from estimator.batching.jobs import Job, jobs_of, readings_and_rig
from estimator.batching.stacked import stacked_fits
from estimator.calibration.calibrate import calibrate, versions
from estimator.calibration.result import SUMMARY_FILE, write_text
from estimator.code_version import code_version
from estimator.diagnosis.fitting import Fit
from estimator.errors import CoilcalError
from estimator.inference.ensemble import SamplerSettings
from estimator.model.measurement_model import MeasurementModel
from estimator.model.preflight import check_readings
from estimator.readings.metrics import HALF_WIDTH_90, errors
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.session import load_session, replace_folder

RESULT_FILE, CALIBRATION_FOLDER, UNFINISHED = "result.json", "calibration", ".unfinished"
MORE_STARTS = 3


def describe(
    path: str,
    rig_text: str,
    hypotheses: tuple[str, ...],
    is_each_coil: bool,
    seed: int,
    settings: SamplerSettings,
) -> tuple[list[Job], dict[str, str]] | str:
    """The jobs of one session and why others cannot be made, or the sentence that says why there are none."""
    try:
        return jobs_of(path, rig_text, hypotheses, is_each_coil, seed, settings)
    except CoilcalError as error:
        return str(error)


def fit(stack: list[Job], folder: str) -> dict[str, str]:
    """Fit jobs of the same rig and settings together and write one result folder each.

    Returns: For each job that failed, by its name, the sentence that says why; the others are not touched by that.
    """
    torch.set_num_threads(1)
    failed: dict[str, str] = {}
    ready: list[tuple[Job, Observations, Rig]] = []
    for job in stack:
        try:
            session, rig = readings_and_rig(job, load_session(job.session))
            check_readings(rig, session.observations, session.source)
            ready.append((job, session.observations, rig))
        except Exception as error:
            failed[job.name] = _words(error)
    for (job, observations, _), found in zip(ready, _fits(ready), strict=True):
        try:
            if isinstance(found, Exception):
                raise found
            _write(Path(folder) / job.name, _record(job, found, observations))
        except Exception as error:
            failed[job.name] = _words(error)
    return failed


def _fits(ready: list[tuple[Job, Observations, Rig]]) -> list[Fit | Exception]:
    """Of all jobs together; where that fails, one by one, for one session of absurd numbers spoils a whole stack."""
    if not ready:
        return []
    rig = ready[0][2]
    try:
        found = stacked_fits(
            rig,
            [observations.calibration for _, observations, _ in ready],
            [job.seed for job, _, _ in ready],
            MORE_STARTS,
        )
    except Exception as error:
        return [error] if len(ready) == 1 else [_fits([one])[0] for one in ready]
    return [Fit(posterior, optimum) for posterior, optimum in found]


def sampled(job: Job, folder: str, settings: SamplerSettings) -> str | None:
    """Sample the posterior of a job that was fitted; a sampling that was cut off, or ended before what is asked for now, goes on there.

    Returns: The sentence that says why there is none, or None.
    """
    torch.set_num_threads(1)
    place = Path(folder) / job.name
    finished, unfinished = place / CALIBRATION_FOLDER, place / f".{CALIBRATION_FOLDER}.unfinished"
    try:
        session, rig = readings_and_rig(job, load_session(job.session))
        with _only_writer(place / RESULT_FILE):
            if is_enough(finished, settings):  # by a worker that was thought to be lost
                return None
            if finished.exists() and not unfinished.exists():
                copy = place / f".{CALIBRATION_FOLDER}.copy"
                shutil.rmtree(copy, ignore_errors=True)
                shutil.copytree(finished, copy)
                copy.rename(unfinished)
            if not is_enough(unfinished, settings):
                (unfinished / SUMMARY_FILE).unlink(missing_ok=True)
                calibrate(session, rig, out=unfinished, seed=job.seed, settings=settings)
            replace_folder(unfinished, finished)
    except CoilcalError as error:
        return str(error)
    return None


def is_enough(posterior: Path, settings: SamplerSettings) -> bool:
    """Whether a posterior meets the targets, or as many steps were taken as are allowed."""
    try:
        sampling = json.loads((posterior / SUMMARY_FILE).read_text(encoding="utf-8"))["sampling"]
    except FileNotFoundError:
        return False
    ess, rhat = sampling["smallest_ess"], sampling["largest_rhat"]
    has_met = ess >= settings.target_ess and rhat is not None and rhat <= settings.largest_rhat
    return bool(has_met or sampling["steps"] >= settings.max_steps)


@contextmanager
def _only_writer(path: Path) -> Iterator[None]:
    """Wait for a worker that goes on with the same job: one whose scheduler was lost does not know of that."""
    import fcntl  # not there on Windows, where results can be read

    with path.open("r+b") as file:
        with suppress(OSError):  # file systems without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _words(error: Exception) -> str:
    return str(error) if isinstance(error, CoilcalError) else f"{type(error).__name__}: {error}"


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
        "is_converged": bool(fit.optimum.is_converged[0]),
        "vector_rmse_T": rmse,
        "versions": versions(),
        "code": code_version(),
    }


def _vector_T(fit: Fit, observations: Observations) -> float:
    with torch.no_grad():
        chain = MeasurementModel.unruled(fit.rig, observations).with_rules(fit.posterior.model.rules)
        predicted_T = chain.predict(fit.values).expand(len(observations), 3)
    return errors(observations.field_sensor_T.numpy(), predicted_T.numpy()).vector_T


def _write(place: Path, record: dict[str, Any]) -> None:
    """A result folder, written under a name of its own and renamed; one that is there already stays, for it holds the same."""
    attempt = f".{place.name}.{uuid.uuid4().hex}{UNFINISHED}"
    if not (place / RESULT_FILE).exists():
        unfinished = place.with_name(attempt)
        unfinished.mkdir(parents=True)
        write_text(unfinished / RESULT_FILE, json.dumps(record, indent=2, allow_nan=False) + "\n")
        with suppress(OSError):  # another attempt was faster
            unfinished.rename(place)
    for left in place.parent.glob(f".{place.name}.*{UNFINISHED}"):
        shutil.rmtree(left, ignore_errors=True)

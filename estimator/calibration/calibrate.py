"""From a session to its calibration: checks, point estimate, Laplace approximation, sampling, summary."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch

from estimator.calibration.chain import new_chain, unfinished_chain
from estimator.calibration.notes import notes
from estimator.calibration.result import Calibration
from estimator.calibration.starting_point import (
    StartingPoint,
    independent,
    is_collapsible,
    starting_point_collapsed,
    starting_point_with_counts,
)
from estimator.calibration.summary import finite, summary
from estimator.devices import device_named, precision_named
from estimator.effects.everywhere import WithEverywhere, with_everywhere
from estimator.effects.use import as_meant
from estimator.errors import InvalidInput
from estimator.inference.collapsed import free_amplitudes
from estimator.inference.ensemble import Progress, SamplerSettings, Samples, sample
from estimator.inference.interpolated import for_sampling
from estimator.inference.laplace import OpenDirection
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.model.preflight import check_precision, check_readings
from estimator.model.unit_gate import check_units
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.emcee_backend import ZarrBackend
from estimator.store.files import writing
from estimator.store.session import Session, check_session

PACKAGES = ("coilcal", "torch", "emcee", "numpy", "scipy", "zarr")
SAMPLING = "posterior sampling with emcee"


@dataclass(frozen=True)
class Stage:
    """A stage of the calibration that has just begun or made progress.

    Attributes:
        name: Name of the stage, in words.
        sampling: Progress of the chain while sampling.
        open_directions: What the data do not determine, known before sampling starts.
    """

    name: str
    sampling: Progress | None = None
    open_directions: tuple[OpenDirection, ...] = ()


def calibrate(
    session: Session,
    rig: Rig | None = None,
    *,
    out: Path | str | None = None,
    overwrite: bool = False,
    seed: int = 0,
    settings: SamplerSettings | None = None,
    has_integer_counts: bool = True,
    as_described: bool = False,
    near: Mapping[str, float] | None = None,
    device: str = "cpu",
    precision: str = "double",
    on_stage: Callable[[Stage], None] | None = None,
) -> Calibration:
    """Calibrate a rig from a session: point estimate, posterior, model.

    Nelder-Mead from many starts, Levenberg-Marquardt, Laplace approximation, then emcee over every free parameter of the rig, loop
    counts as whole numbers. Amplitudes of coils without a winding are integrated out in closed form and drawn given the rest, where the
    readings are linear in them; loop counts of other coils of the rig are then real numbers.

    Args:
        session: Readings; those marked as validation are kept out of the fit.
        rig: Another description of the session's rig (other priors, other free parameters).
        out: Folder for `summary.json`, `posterior.zarr` and the growing chain. A run that was killed, or that ended at `max_steps`, is
            continued from there.
        overwrite: Replace a calibration in `out` instead, once the new one starts sampling.
        seed: Seed of all random numbers.
        settings: When to stop sampling; its seed is replaced by `seed`.
        has_integer_counts: False treats free loop counts as real numbers.
        as_described: Fit the rig as it is described. Otherwise a field of the room, such as the Earth's, and the zero of each sensor are
            fitted too where the rig does not mention them, and the currents tell them from the fields of the coils.
        near: Values of the free parameters near the maximum, where they are known, as from a fit of these readings. Nelder-Mead, which
            searches for them from many starts, is left out then, unless coils without a winding are calibrated.
        device: Where the readings are predicted, such as `cuda`; sampling itself and all reports stay on the processor.
        precision: `double`, or `single` for the predictions of readings; densities and fits are in double precision all the same.
        on_stage: Called as the work proceeds.
    Returns: The calibrated model. `summary()["is_converged"]` is False if sampling ended before it reached its targets.
    Raises:
        InvalidInput: The readings cannot support a fit, or are in another unit than they claim; `out` holds another calibration or cannot
            be written; the settings do not suit the rig.
        CorruptStore: The chain to be continued is damaged.
    References: Osinde et al., section 3; docs/decisions/0004 and 0007.
    """
    tell = on_stage or (lambda stage: None)
    place, dtype = device_named(device), precision_named(precision)
    check_session(session)
    completed = _rig_to_fit(session, rig or session.rig, has_integer_counts, as_described)
    rig = completed.rig
    given_settings = replace(settings or SamplerSettings(), seed=seed)
    settings = given_settings.for_rig(len(rig.free) - len(free_amplitudes(rig)))
    folder = None if out is None else Path(out)
    # Nothing is added by default, so that chains that older versions began can be continued.
    unusual = [] if (device, precision) == ("cpu", "double") else [device, precision]
    unusual += [] if near is None else [json.dumps(dict(near))]
    fingerprint = _fingerprint(session, rig, settings, has_integer_counts, unusual)
    backend = unfinished_chain(folder, fingerprint, overwrite)
    observations = as_meant(rig, session.observations)
    warnings = check_units(rig, observations, session.source)
    MeasurementModel.build(rig, session.observations)  # refuses sensors inside a winding, in validation too
    if folder is not None:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)

    tell(Stage("point estimate: Nelder-Mead from many starts, then Levenberg-Marquardt"))
    if dtype is not torch.float64:
        _check_single(rig, observations.calibration, precision)
    readings = observations.calibration.to(place, dtype)
    start = _starting_point(rig, readings, seed, has_integer_counts, near, tell)
    posterior = start.posterior
    settings = given_settings.for_rig(posterior.coordinates.n)
    tell(Stage(SAMPLING))
    if posterior.amplitudes and not posterior.coordinates.n:
        samples = independent(posterior, settings)
    else:
        chain = backend or new_chain(folder, posterior.coordinates, settings, fingerprint, overwrite)
        sampled = for_sampling(posterior, start.mixture, seed)
        samples = sample(
            sampled, start.mixture, settings, chain, lambda progress: tell(Stage(SAMPLING, progress))
        )
        if isinstance(chain, ZarrBackend):
            chain.flush()

    tell(Stage("errors, coverage and summary"))
    draws, log_prob = start.draws(samples.chain, seed), np.ascontiguousarray(samples.log_prob.T)
    calibration = Calibration(rig, session.observations, start.best(), draws, log_prob, {})
    of_amplitudes = start.summary(readings)
    summary_json = {
        **summary(session, calibration, of_amplitudes.get("next_degree_log_evidence"), samples.is_converged),
        "fitted_besides": [cause.label for cause in completed.added],
        "notes": [*warnings, *notes(completed, session.observations)],
        "is_converged": samples.is_converged,
        "has_integer_counts": posterior.coordinates.n_counts > 0,
        "sampling": _sampling(samples),
        "point_estimate": _point_estimate(rig, start),
        "undetermined": [asdict(direction) for direction in start.undetermined],
        **of_amplitudes,
        "seed": seed,
        "versions": versions(),
    }
    calibration = replace(calibration, summary_json=summary_json)
    if folder is not None:
        calibration.save(folder)
    return calibration


def _check_single(rig: Rig, observations: Observations, precision: str) -> None:
    """Refuse single precision where it does not suffice."""
    if free_amplitudes(rig):  # their columns are differences of predictions
        raise InvalidInput(
            f"coils without a winding must be calibrated in double precision; received precision {precision}"
        )
    check_precision(rig, observations)


def _starting_point(
    rig: Rig,
    readings: Observations,
    seed: int,
    has_integer_counts: bool,
    near: Mapping[str, float] | None,
    tell: Callable[[Stage], None],
) -> StartingPoint:
    """The maximum of the posterior and what is sampled about it."""
    posterior = LogPosterior(Coordinates(rig), MeasurementModel.build(rig, readings), readings)
    if is_collapsible(posterior):
        start = starting_point_collapsed(posterior, readings, seed)
        tell(Stage("amplitudes in closed form", open_directions=start.undetermined))
        return start
    return starting_point_with_counts(
        posterior,
        readings,
        seed,
        lambda p: LogPosterior(Coordinates(rig, has_integer_counts), p.model, readings),
        lambda name, undetermined: tell(Stage(name, open_directions=undetermined)),
        near,
    )


def _rig_to_fit(session: Session, rig: Rig, has_integer_counts: bool, as_described: bool) -> WithEverywhere:
    """The rig with what no laboratory is without; refuse one that the readings cannot support."""
    session.check_rig(rig)
    _check_free(rig, has_integer_counts)
    check_readings(rig, session.observations, session.source)
    return WithEverywhere(rig) if as_described else with_everywhere(rig, session.observations.calibration)


def _check_free(rig: Rig, has_integer_counts: bool) -> None:
    """Refuse a rig without a free parameter, or with free loop counts only."""
    rig.check_free()
    if has_integer_counts and all(parameter.is_count for parameter in rig.free):
        raise InvalidInput(
            "rig must have a free parameter besides loop counts, such as the noise of a sensor, or counts must be continuous; "
            f"rig {rig.name!r} has none"
        )


def _fingerprint(
    session: Session, rig: Rig, settings: SamplerSettings, has_integer_counts: bool, unusual: Sequence[str]
) -> str:
    """Hash of everything that decides the steps of a chain; the targets that stop it do not."""
    decisive = {"walkers": settings.n_walkers, "every": settings.check_every, "seed": settings.seed}
    parts = [session.hash, rig.hash, json.dumps(decisive), str(has_integer_counts), json.dumps(versions())]
    return hashlib.sha256("\n".join([*parts, *unusual]).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide a result."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def _sampling(samples: Samples) -> dict[str, Any]:
    return {
        "steps": samples.n_steps,
        "walkers": samples.log_prob.shape[1],
        "acceptance": samples.acceptance,
        "smallest_ess": samples.convergence.smallest_ess,
        "largest_rhat": finite(samples.convergence.largest_rhat),
    }


def _point_estimate(rig: Rig, start: StartingPoint) -> dict[str, Any]:
    estimate = start.estimate
    return {
        "values": {parameter.name: float(start.values[parameter.name]) for parameter in rig.free},
        "nelder_mead_evaluations": estimate.n_evaluations,
        "starts": estimate.n_starts,
        "starts_agreeing": estimate.n_agreeing,
        "is_converged": bool(estimate.fit.is_converged[0]),
    }

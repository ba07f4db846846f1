"""The posterior of an extended rig, widened by what remains unexplained."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from estimator.calibration.calibrate import Stage, calibrate
from estimator.calibration.files import remove_calibration
from estimator.calibration.result import Calibration
from estimator.calibration.summary import summary
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.instants import on_known_sides
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.validation import posterior_scores
from estimator.diagnosis.widening import Widening, have_whole_counts
from estimator.errors import InvalidInput
from estimator.inference.collapsed import free_amplitudes
from estimator.inference.ensemble import SamplerSettings
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.store.session import Session

# Half of what a calibration takes: ends of 90 % intervals to a twentieth of a standard deviation, and minutes fewer where draws mix badly.
LONG_ENOUGH = SamplerSettings(target_ess=1000.0, max_steps=6000)
ROUNDING = 1e-12  # of a variance: leaves a correlation matrix positive definite


def extended_posterior(
    session: Session,
    rig: Rig,
    widening: Widening | None,
    *,
    out: Path | None = None,
    seed: int = 0,
    settings: SamplerSettings = LONG_ENOUGH,
    device: str = "cpu",
    precision: str = "double",
    on_stage: Callable[[Stage], None] | None = None,
) -> Calibration:
    """Calibrate the extended rig; widen the draws where something remains unexplained.

    Amplitudes of corrections, of which there may be many, are not sampled by emcee: the readings are linear in them, so given the rest they
    are normal. The rest is sampled beside their best values, and the widening gives both the width that they have together.

    Args:
        session: Readings; those marked as validation are kept out.
        rig: The extended rig.
        widening: By how much to widen; None where nothing remains unexplained.
        out, seed, settings, on_stage: As in `calibrate`; what `out` holds is replaced.
        device, precision: Likewise, but where amplitudes are integrated out, which is done in double precision.
    Returns: The calibrated model. Where its draws were widened, `summary()["widening"]` holds the factor by which the standard deviation of
        each parameter grew, but for those that had a single value; loop counts are real numbers where too many are plausible then.
    """
    amplitudes = [] if widening is None else _amplitudes(rig)
    held = rig.with_fixed(amplitudes) if amplitudes else rig
    if free_amplitudes(held):
        precision = "double"
    sampled = calibrate(
        session,
        held,
        out=out,
        overwrite=True,
        as_described=True,
        seed=seed,
        settings=settings,
        device=device,
        precision=precision,
        on_stage=on_stage,
    )
    if widening is None:
        return sampled
    if amplitudes:
        drawn = drawn_beside(widening.fit, amplitudes, sampled.draws, seed)
        sampled = replace(sampled, rig=rig, draws={**sampled.draws, **drawn})
    wider = replace(sampled, draws=widening.spread(sampled.draws, seed))
    factors = {
        name: float(wider.draws[name].std() / draws.std())
        for name, draws in sampled.draws.items()
        if draws.std() > 0.0
    }
    of_wider = {
        "has_integer_counts": sampled.summary()["has_integer_counts"] and have_whole_counts(rig, wider.draws),
        "widening": factors,
    }
    wider = replace(wider, summary_json={**sampled.summary(), **summary(session, wider), **of_wider})
    if out is not None:
        wider.save(out)
    return wider


def drawn_beside(
    fit: Fit, amplitudes: Sequence[str], draws: Mapping[str, np.ndarray], seed: int
) -> dict[str, np.ndarray]:
    """Draws of amplitudes from their normal posterior given draws of all else.

    Args:
        fit: With all of them; its covariance says how amplitudes go along with the rest.
        amplitudes: Names of the parameters to draw.
        draws: Of the other free parameters, walker by step.
        seed: Of the draws.
    References: Bishop, Pattern Recognition and Machine Learning (2006), eq 2.81 and 2.82 (conditional normal).
    """
    names = fit.posterior.coordinates.names
    own = [names.index(name) for name in amplitudes]
    rest = [i for i in range(len(names)) if i not in own]
    flat = {name: torch.from_numpy(array.reshape(-1)) for name, array in draws.items()}
    away = (fit.posterior.coordinates.vector(flat) - fit.vector)[:, rest]
    following = torch.linalg.solve(fit.covariance[rest][:, rest], fit.covariance[rest][:, own]).T
    given = fit.covariance[own][:, own] - following @ fit.covariance[rest][:, own]
    scale = torch.diagonal(given).clamp(min=1e-300).sqrt()
    root = scale[:, None] * torch.linalg.cholesky(
        given / (scale[:, None] * scale) + ROUNDING * torch.eye(len(own)).double()
    )
    noise = torch.randn(
        len(away), len(own), generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )
    drawn = fit.vector[own] + away @ following.T + noise @ root.T
    shape = next(iter(draws.values())).shape
    return {name: drawn[:, i].reshape(shape).numpy() for i, name in enumerate(amplitudes)}


def _amplitudes(rig: Rig) -> list[str]:
    """Free parameters of the rig's corrections."""
    labels = tuple(f"{correction.label}." for correction in rig.corrections)
    return [p.name for p in rig.free if labels and p.name.startswith(labels)]


class _Stopped(Exception):
    """The posterior is no longer wanted."""


def with_posterior(
    result: Diagnosis, session: Session, limits: Limits, out: Path | None, device: str, precision: str
) -> Diagnosis:
    """A diagnosis with the posterior of its extended rig; without it where it is stopped meanwhile, or where that rig is refused."""

    def unless_stopped(_: Stage) -> None:
        if limits.stopped.is_set():
            raise _Stopped

    try:
        sampled = extended_posterior(
            session,
            result.extended_rig,
            result.left_open.widening,
            out=out,
            seed=result.question.seed,
            device=device,
            precision=precision,
            on_stage=unless_stopped,
        )
    except (_Stopped, InvalidInput) as error:
        if out is not None:
            remove_calibration(out)
            with suppress(OSError):
                out.rmdir()
        return replace(result, posterior_refusal="" if isinstance(error, _Stopped) else str(error))
    return replace(result, posterior=sampled)


def judged_as_handed_out(result: Diagnosis, posterior: Calibration, unseen: Observations) -> Diagnosis:
    """A diagnosis whose errors on unseen readings are those of the model that was sampled, with its whole counts and its draws."""
    fits = result.fits
    assert fits.improvement is not None
    scores = posterior_scores(fits.final, posterior, on_known_sides(fits.final, unseen))
    correction = fits.correction
    if correction is not None and correction.is_taken and correction.gain is not None:
        correction = replace(correction, gain=correction.gain.with_after(scores))
    improvement = fits.improvement.with_after(scores)
    return replace(result, fits=replace(fits, improvement=improvement, correction=correction))

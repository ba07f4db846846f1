"""The posterior of an extended rig, as wide as what remains unexplained."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch

from estimator.calibration.calibrate import Stage, calibrate, versions
from estimator.calibration.files import check_calibration, remove_calibration
from estimator.calibration.quality import Assessment, Quality
from estimator.calibration.result import Calibration
from estimator.calibration.summary import summary
from estimator.diagnosis import policy
from estimator.diagnosis.corrections.result import told_together
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.instants import on_known_sides
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.validation import posterior_scores
from estimator.diagnosis.widening import Widening, have_whole_counts
from estimator.errors import InvalidInput
from estimator.inference.collapsed import free_amplitudes
from estimator.inference.ensemble import SamplerSettings
from estimator.inference.laplace import open_directions
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.readings.observations import Observations
from estimator.reporting.numbers import probability
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.files import writing
from estimator.store.session import Session

# Half of what a calibration takes: ends of 90 % intervals to a twentieth of a standard deviation, and minutes fewer where draws mix badly.
LONG_ENOUGH = SamplerSettings(target_ess=1000.0, max_steps=6000)
WALKERS, STEPS = 32, 125  # independent draws of a normal law, in the shape of a chain


def extended_posterior(
    session: Session,
    rig: Rig,
    widening: Widening | None,
    *,
    near: Mapping[str, float] | None = None,
    out: Path | None = None,
    seed: int = 0,
    device: str = "cpu",
    precision: str = "double",
    on_stage: Callable[[Stage], None] | None = None,
) -> Calibration:
    """Calibrate the extended rig: by sampling where it explains the readings, by draws of a normal law where something remains unexplained.

    The density that is sampled takes the model to be exact. Where the model is not, the widening says how uncertain the numbers are, and
    that is a covariance: draws of the normal law with it, about the fit, say as much, and cost no evaluation of the density.

    Args:
        session: Readings; those marked as validation are kept out.
        rig: The extended rig.
        widening: Of its fit; None where nothing remains unexplained.
        near, out, seed, on_stage: As in `calibrate`; what `out` holds is replaced.
        device, precision: Likewise, where the posterior is sampled.
    Returns: The calibrated model. Where it is widened, `summary()["widening"]` holds the factor by which the standard deviation of each
        parameter grew; loop counts are real numbers where too many are plausible.
    """
    if widening is None:
        return calibrate(
            session,
            rig,
            out=out,
            overwrite=True,
            as_described=True,
            near=near,
            seed=seed,
            settings=LONG_ENOUGH,
            device=device,
            precision="double" if free_amplitudes(rig) else precision,
            on_stage=on_stage,
        )
    wide = _drawn(session, rig, widening, seed)
    if out is not None:
        check_calibration(out)
        with writing(out):
            out.mkdir(parents=True, exist_ok=True)
        remove_calibration(out)
        wide.save(out)
    return wide


def _drawn(session: Session, rig: Rig, widening: Widening, seed: int) -> Calibration:
    """The extended rig with draws as wide as the widening."""
    fit = widening.fit
    draws, log_prob = widening.drawn(WALKERS, STEPS, seed)
    calibration = Calibration(rig, session.observations, _best(fit, draws), draws, log_prob, {})
    return replace(
        calibration,
        summary_json={
            **summary(session, calibration),
            "is_converged": True,  # independent draws
            "has_integer_counts": have_whole_counts(rig, draws),
            "sampling": {
                "steps": STEPS,
                "walkers": WALKERS,
                "acceptance": 1.0,
                "smallest_ess": float(WALKERS * STEPS),
                "largest_rhat": 1.0,
            },
            "point_estimate": {
                "values": {parameter.name: float(fit.values[parameter.name]) for parameter in rig.free},
                "nelder_mead_evaluations": 0,
                "starts": 1,
                "starts_agreeing": 1,
                "is_converged": bool(fit.optimum.is_converged[0]),
            },
            "undetermined": [
                asdict(each) for each in open_directions(fit.posterior.coordinates, fit.optimum)
            ],
            "seed": seed,
            "versions": versions(),
            "widening": widening.factors,
        },
    )


def _best(fit: Fit, draws: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Every number of the rig at the maximum, with the most probable whole loop counts where the draws have such."""
    names = [parameter.name for parameter in fit.rig.free if parameter.is_count]
    if not names or not have_whole_counts(fit.rig, draws):
        return {name: float(value) for name, value in fit.values.items()}
    counts = np.stack([draws[name].ravel() for name in names], axis=1)
    _, row, n_draws = np.unique(counts, axis=0, return_inverse=True, return_counts=True)
    is_most_probable = row.ravel() == n_draws.argmax()
    whole = LogPosterior(Coordinates(fit.rig, integer_counts=True), fit.posterior.model, fit.observations)
    alike = whole.coordinates.vector(
        {name: torch.from_numpy(values.ravel()[is_most_probable]) for name, values in draws.items()}
    )
    best = levenberg_marquardt(whole, alike.mean(0, keepdim=True)).vector[0]
    return {name: float(value) for name, value in whole.coordinates.values(best).items()}


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
            near={name: float(value) for name, value in result.fits.final.values.items()},
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
    if words := doubts(result):
        sampled = doubted(sampled, words)
        if out is not None:
            sampled.save(out)
    return replace(result, posterior=sampled)


def doubts(result: Diagnosis) -> list[str]:
    """What the extended rig takes for granted, what its predictions are without, and that it does not explain all."""
    words = [
        f"it holds only if {sized.name} is what is wrong ({probability(sized.probability)})."
        for sized in result.sized_causes
        if sized.probability < policy.STATED
    ]
    if stand_ins := result.findings.stand_ins:
        names = ", ".join(map(result.label, stand_ins))
        words.append(f"it has {names}, not sure enough to be stated.")
    correction = result.fits.correction
    if correction is not None and correction.is_taken:
        of_readings = [part for part in correction.parts if not part.is_predicted]
        if of_readings:
            names = told_together(of_readings, result.label)
            words.append(f"it follows readings with {names}, which no prediction has.")
    if result.verdict.leaves_something:
        words.append("the diagnosis found something wrong that this rig does not describe.")
    return words


def doubted(calibration: Calibration, words: Sequence[str]) -> Calibration:
    """A calibration that is no better than suspect, for some reasons beside its own."""
    quality = calibration.summary_json["quality"]
    own = [] if quality["verdict"] == Quality.GOOD else quality["reasons"]
    verdict = Quality.UNUSABLE if quality["verdict"] == Quality.UNUSABLE else Quality.SUSPECT
    next_step = (
        quality["next"] if own else "Tell the causes apart first: the diagnosis says what they may be."
    )
    told = Assessment(verdict, (*own, *words), next_step).to_json()
    return replace(calibration, summary_json={**calibration.summary_json, "quality": told})


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

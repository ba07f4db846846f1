"""Discrete mistakes of the record, undone before the search: axes, signs, units, frames of displacements.

Each makes the readings absurd unless undone. All starts of all mistakes are compared on a few readings, with one linear step from the
nominal rig; the best few that do no worse than the record as it is are fitted. Where noise and parameters are as expected, no mistake
is looked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.calibration import policy as calibration_policy
from estimator.diagnosis import effort, policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.instants import (
    MOST_INSTANTS,
    best_instants,
    changes_at_its_instant,
    instants_in,
    starts_between,
)
from estimator.diagnosis.verdict import NamedCause
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import SINCE, UNTIL
from estimator.effects.stages import RecordEffect
from estimator.effects.use import shifts_rows, uses_of
from estimator.inference.likelihood import LogPosterior
from estimator.readings.observations import Observations
from estimator.readings.scatter import scatter_T
from estimator.readings.split import spread
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Cause, Rig

MOST_MISTAKES = 3  # that are undone one after another
# Ways of a mistake up to which it is looked for where nothing is absurd, as in weak fields
MOST_STARTS_OF_FAINT = 2

MOST_TOGETHER = 16  # starts in one batch; more would not fit the processor's cache


def without_record_mistakes(base: Fit) -> tuple[Fit, list[NamedCause]]:
    """Undo mistakes of the record one after another while the evidence suffices.

    Returns: The fit with the mistakes as effects of its rig, and the mistakes with others that would explain the readings as well.
    """
    mistakes: list[NamedCause] = []
    while len(mistakes) < MOST_MISTAKES:
        is_faint = _is_as_expected(base) and not _is_noisy(base)
        most_starts = MOST_STARTS_OF_FAINT if is_faint else None
        fits = sorted(_fits_with_mistake(base, most_starts), key=lambda fit: -fit.log_evidence)
        if not fits or fits[0].log_evidence - base.log_evidence < policy.LEAST_LOG_EVIDENCE_OF_MISTAKE:
            break
        best = fits[0]
        others = [(fit.rig.effects[-1], fit.log_evidence - best.log_evidence) for fit in fits[1:]]
        twins = {
            cause: value
            for cause, value in reversed(others)
            if value > -policy.CLEAR_LOG_EVIDENCE and cause != best.rig.effects[-1]
        }
        evidence = {best.rig.effects[-1]: 0.0, **twins}
        mistakes.append(NamedCause.among(evidence, best.log_evidence - base.log_evidence))
        base = best
    return base, mistakes


def leaves_much_of_the_field(fit: Fit) -> bool:
    """Whether the residual is a share of the field that no cause but a mistake leaves; of weak fields noise alone is such a share."""
    measured = fit.posterior.measured_T * fit.whitening_per_T
    share = float(fit.residual.square().sum() / measured.square().sum())
    return share > policy.LEAST_LEFT_BY_MISTAKE**2 and not _is_as_expected(fit)


def _is_as_expected(fit: Fit) -> bool:
    """Whether the residual, the fitted noise and the fitted parameters are all as expected."""
    if float(fit.residual.square().mean()) > policy.LARGEST_MEAN_SQUARE:
        return False
    priors = {parameter.name: parameter.prior for parameter in fit.rig.free if parameter.prior is not None}
    distances_sd = (abs(prior.distance(float(fit.values[name]))) for name, prior in priors.items())
    return all(distance_sd <= calibration_policy.FAR_SD for distance_sd in distances_sd)


def _is_noisy(fit: Fit) -> bool:
    """Whether a free noise has grown beyond what readings at the same places show, or else its prior: it may hide what is absurd."""
    by_sensor = scatter_T(fit.observations, len(fit.rig.sensors))
    for sensor, scattered_T in zip(fit.rig.sensors, by_sensor, strict=True):
        name = f"{sensor.name}.noise_T"
        prior = fit.rig.parameters[name].prior
        if prior is None:
            continue
        expected_T = prior.centre if scattered_T is None else scattered_T
        if float(fit.values[name]) > calibration_policy.LARGER_THAN_NOISE * expected_T:
            return True
    return False


def _fits_with_mistake(base: Fit, most_starts: int | None) -> list[Fit]:
    """Full fits of the mistakes that fit a few readings best, and no worse than the record as it is.

    Args:
        base: The record as it is.
        most_starts: Mistakes with more are left out.
    """
    circumstances = base.circumstances
    observations = circumstances.observations
    few = spread(observations, effort.MOST_READINGS_COMPARED)
    present = {cause.name for cause in base.rig.effects}
    are_rows_shifted = any(shifts_rows(use.effect) for use in uses_of(base.rig, RecordEffect))
    rules = base.posterior.model.rules
    as_recorded = LogPosterior.by_rules(Coordinates(base.rig), few, rules)
    (least_stepped,) = _after_linear_step(as_recorded, as_recorded.coordinates.start()[None])
    least_stepped -= policy.CLEAR_LOG_EVIDENCE
    ranked: list[tuple[float, Cause, Mapping[str, float]]] = []
    is_absurd = leaves_much_of_the_field(base)
    # From the record back to the supply: of mistakes that explain the readings equally, the last one made comes first.
    for name, effect in reversed(EFFECTS.items()):
        if not effect.is_record_mistake or name in present:
            continue
        if are_rows_shifted and shifts_rows(effect):
            continue
        for place in effect.places(base.rig):
            if not effect.concerns(circumstances, place):
                continue
            cause, starts = Cause(name, place), effect.starts(circumstances, place)
            if not is_absurd and any(SINCE in start for start in starts):
                continue
            if most_starts is not None and len(starts) > most_starts:
                continue
            values = _start_log_likelihoods(base, cause, starts, few)
            ranked += [
                (value, cause, start)
                for value, start in best_instants(values, starts)
                if value > least_stepped
            ]
    if not ranked:
        return []
    ranked.sort(key=lambda scored: -scored[0])
    least = (
        fit_rig(base.rig, few, base.values, rules, tolerance=effort.ROUGH_TOLERANCE).log_evidence
        - policy.CLEAR_LOG_EVIDENCE
    )
    rigs = [
        with_effect(base.rig, cause, observations, _at_finest_instant(base, cause, start))
        for _, cause, start in ranked[: effort.MOST_MISTAKES_FITTED]
    ]
    trials = [
        fit_rig(rig, few, rig.nominal_values(), rules, tolerance=effort.ROUGH_TOLERANCE) for rig in rigs
    ]
    plausible = [
        trial for trial in trials if trial.still_has(trial.rig.effects[-1]) and trial.log_evidence > least
    ]
    fits = [fit_rig(trial.rig, observations, trial.values, rules) for trial in plausible]
    return [
        fit
        for fit in fits
        if fit.still_has(fit.rig.effects[-1]) and _explains_a_field(fit) and changes_at_its_instant(fit)
    ]


def _at_finest_instant(base: Fit, cause: Cause, start: Mapping[str, float]) -> Mapping[str, float]:
    """A start with its instants, where it has any, each between the two readings that fit all readings best."""
    circumstances = base.circumstances
    for key in instants_in(start):
        begin_h = start[SINCE] if key == UNTIL else 0.0
        end_h = start[UNTIL] if key == SINCE and UNTIL in start else circumstances.duration_h
        nearer = starts_between(circumstances, begin_h, end_h, start, key)
        while len(nearer) > 1:
            values = _start_log_likelihoods(base, cause, nearer, circumstances.observations)
            top = max(range(len(nearer)), key=lambda i: values[i])
            start, beside = nearer[top], nearer[max(top - 1, 0) : top + 2]
            narrower = starts_between(circumstances, beside[0][key], beside[-1][key], start, key)
            nearer = narrower if len(nearer) == MOST_INSTANTS else []
    return start


def _explains_a_field(fit: Fit) -> bool:
    """Whether a fit does better than no field at all: coils that a wrong unit puts far away explain noise, and nothing else."""
    measured = fit.posterior.measured_T * fit.whitening_per_T
    explained = 0.5 * float(measured.square().sum() - fit.residual.square().sum())
    return explained > policy.LEAST_LOG_EVIDENCE_OF_MISTAKE


def _start_log_likelihoods(
    base: Fit, cause: Cause, starts: Sequence[Mapping[str, float]], observations: Observations
) -> list[float]:
    """Log likelihood of each start of a mistake, at the best common noise.

    The parameters take one linear step from the nominal rig, within their priors.
    """
    effect, log_likelihoods = EFFECTS[cause.name], list[float]()
    moves_rows = isinstance(effect, RecordEffect) and any(effect.rows_late(start) for start in starts)
    # Readings have other poses where rows move, and amplitudes of corrections are columns of one model.
    together = 1 if moves_rows or base.rig.corrections else MOST_TOGETHER
    for first in range(0, len(starts), together):
        some = starts[first : first + together]
        rig = with_effect(base.rig, cause, base.observations, some[0])
        posterior = LogPosterior.by_rules(
            _AtStarts(rig, cause, some), observations, base.posterior.model.rules
        )
        log_likelihoods += _after_linear_step(posterior, posterior.coordinates.start())
    return log_likelihoods


def _after_linear_step(posterior: LogPosterior, vector: Float[Tensor, "start coordinate"]) -> list[float]:
    """Log likelihood after one linear step from each start."""
    with torch.no_grad():
        unit = posterior.component_sigma_T(vector).mean(-1) / posterior.sigma_T(vector).mean(-1)
        residual = (posterior.measured_T - posterior.predicted(vector)) / unit[:, None]
        jacobian = posterior.jacobian(vector) / unit[:, None, None] * posterior.coordinates.scale
    prior = vector.new_ones(vector.shape[-1]).diag()
    noise_T = residual.square().mean(-1).sqrt()
    step = torch.zeros_like(vector)
    for _ in range(2):  # the first step still has the noise of absurd readings
        weighted, target = jacobian / noise_T[:, None, None], residual / noise_T[:, None]
        step = torch.linalg.solve(weighted.mT @ weighted + prior, (weighted.mT @ target[..., None])[..., 0])
        remainder = residual - (jacobian @ step[..., None])[..., 0]
        noise_T = remainder.square().mean(-1).sqrt().clamp(min=1e-9)
    log_likelihood = -residual.shape[-1] * torch.log(noise_T * unit) - 0.5 * step.square().sum(-1)
    return list(log_likelihood.tolist())


class _AtStarts(Coordinates):
    """Coordinates for a mistake whose fixed numbers differ from row to row."""

    def __init__(self, rig: Rig, cause: Cause, starts: Sequence[Mapping[str, float]]) -> None:
        super().__init__(rig)
        self._rows = {
            f"{cause.label}.{key}": torch.tensor([start[key] for start in starts], dtype=torch.float64)
            for key in starts[0]
        }
        self._n_rows = len(starts)

    def start(self) -> Float[Tensor, "start coordinate"]:
        """Coordinates of every start."""
        return self.vector(self._rows).expand(self._n_rows, -1)

    def values(self, vector: Float[Tensor, "start coordinate"]) -> dict[str, Tensor]:
        """Every number of the rig."""
        return {**super().values(vector), **self._given(vector)}

    def values_of_each(self, columns: Sequence[Float[Tensor, " start"]]) -> dict[str, Tensor]:
        """Every number of the rig at each start, given the coordinates one by one."""
        return {**super().values_of_each(columns), **self._given(columns[0])}

    def _given(self, like: Tensor) -> dict[str, Tensor]:
        """The fixed numbers of every start."""
        return {name: value.to(like) for name, value in self._rows.items() if name not in self.names}

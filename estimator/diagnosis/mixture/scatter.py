"""Causes that change only how readings scatter, asked beside what leads: until it is named, anything looks like scatter."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.noise import noise_causes
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.climb import climbed
from estimator.diagnosis.mixture.confirmed import confirmed
from estimator.diagnosis.mixture.full_fits import fit_with, leading_fit
from estimator.diagnosis.mixture.imitation import Standing
from estimator.diagnosis.progress import OnProgress, unwatched
from estimator.diagnosis.verdict import NamedCause
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause

MOST_SCATTERING = 2  # causes of scatter, one after the other


@dataclass(frozen=True)
class BesideScatter:
    """What the readings say, and the causes that the rig was given for it: of scatter, or of a body that sits far off.

    Attributes:
        answer: With them.
        given: How probable each is, if nothing acts that no list holds.
    """

    answer: Answer
    given: tuple[NamedCause, ...]

    @property
    def stated(self) -> list[NamedCause]:
        """The given causes that are rather there than something unlisted that looks like them.

        All that does not come again looks like scatter: 4 names of 30 were wrong, as of causes whose start is chosen.
        """
        names = self.answer.evidence_of_names
        strongest = max(names, default=0.0)
        stated = []
        for cause in self.given:
            standing = Standing(cause.log_bayes_factor, strongest, n_others=len(names), is_chosen=True)
            real = 1.0 - standing.p_imitation
            others = tuple(replace(a, probability=real * a.probability) for a in cause.alternatives)
            absent = 1.0 - real * (1.0 - cause.p_not_in_library)
            stated.append(
                replace(
                    cause, probability=real * cause.probability, alternatives=others, p_not_in_library=absent
                )
            )
        return [cause for cause in stated if cause.p_not_in_library < 0.5]


def answer_beside_scatter(
    plain: Fit,
    limits: Limits,
    seed: int,
    tell: Callable[[str], None],
    on_progress: OnProgress = unwatched,
) -> BesideScatter:
    """Ask the readings what is wrong; where they scatter otherwise than the rig says, again with what makes them.

    Args:
        plain: Fit of the rig as described.
        limits: Causes that are asked, and the time.
        seed: Of blocks, halves and draws.
        tell: Called with a message for each cause of scatter.
        on_progress: Called after each expansion and each half.
    """
    described = plain
    first, asked = climbed(plain, limits, seed, on_progress)
    scattering = list[NamedCause]()
    while len(scattering) < MOST_SCATTERING and not limits.is_over:
        if not (clear := _clear(Answer(first, asked))):
            break
        named, fitted = clear
        scattering.append(named)
        tell(f"readings scatter as {named.cause.label} would make them: asking again beside it")
        plain = _with(plain, named.cause, fitted)
        first, asked = climbed(plain, limits, seed, on_progress, asked)
    if scattering and not limits.is_over:  # what was found beside it may be what looked like it
        alone = climbed(described, limits, seed, on_progress, asked)
        if not _clear(Answer(*alone)):
            (first, asked), scattering = alone, []
    return BesideScatter(confirmed(first, asked, limits, seed, on_progress=on_progress), tuple(scattering))


def _clear(answer: Answer) -> tuple[NamedCause, Fit] | None:
    """The best cause of scatter with its fit, where one is as probable as what is stated."""
    if answer.is_full:
        return None
    rows = sorted(_scattering(answer), key=lambda row: -row[1])
    log_prior_odds = _log_prior_odds(answer.asked, len(rows))
    if not rows or rows[0][1] + log_prior_odds < math.log(policy.STATED / (1.0 - policy.STATED)):
        return None
    return _named(rows, log_prior_odds), rows[0][2]


def _scattering(answer: Answer) -> list[tuple[Cause, float, Fit]]:
    """Causes of scatter with their log Bayes factors and fits: beside what leads, in the place of its departures, and in the place of all.

    What leads by readings that are linear may fit worse than what was fitted last. Scatter that is not the same everywhere looks like
    departures, and like causes that follow single readings. So does a record that was put right wrongly, whose departures tell so. A fit
    has the noise that is stated, where it is stated as known.
    """
    asked, items = answer.asked, answer.asked.dictionary.items
    rows = noise_causes(max(leading_fit(answer), asked.expansion.fit, key=lambda fit: fit.log_evidence))
    if any(EFFECTS[cause.name].is_record_mistake for cause in answer.plain.rig.effects):
        return rows
    listed = tuple(i for i in asked.leading if items[i].is_listed)
    instead = list[tuple[Asked, tuple[int, ...], Fit]]()
    if len(listed) < len(asked.leading):
        instead.append((asked, listed, fit_with(answer, [items[i].cause for i in listed])))
    if listed:
        instead.append((answer.first, (), answer.plain))
    for there, chosen, fit in instead:
        of_fit = there.log_density_of(chosen) + there.slots.log_share_of_stated_noise(chosen)
        lost = asked.log_density - of_fit
        rows += [(cause, value - lost, fitted) for cause, value, fitted in noise_causes(fit)]
    best = {row[0]: row for row in sorted(rows, key=lambda row: row[1])}
    return list(best.values())


def _log_prior_odds(asked: Asked, n_more: int) -> float:
    """Log prior odds of a listed cause of a dictionary, or of one of some more, against nothing."""
    names = {item.cause.name for item in asked.dictionary.items if item.is_listed}
    return math.log(policy.LISTED / policy.p_empty()) - math.log(len(names) + n_more)


def _named(rows: list[tuple[Cause, float, Fit]], log_prior_odds: float) -> NamedCause:
    """The best cause of scatter, with those that explain it nearly as well."""
    evidence = {cause: value for cause, value, _ in rows}
    values = torch.tensor(list(evidence.values()), dtype=torch.float64)
    p_any = 1.0 / (1.0 + math.exp(-float(torch.logsumexp(values, 0)) - log_prior_odds))
    return NamedCause.among(evidence, rows[0][1], p_any)


def _with(plain: Fit, cause: Cause, fitted: Fit) -> Fit:
    """The rig as described with a cause of scatter, fitted to all that was read.

    Args:
        plain: Without it.
        cause: The cause of scatter.
        fitted: With it, to the readings without what else leads.
    """
    names = fitted.rig.names_of(cause)
    values = {name: float(fitted.values[name]) for name in names.values()}
    start = {key: values[name] for key, name in names.items()}
    rig = with_effect(plain.rig, cause, plain.observations, start)
    noises = {name: v for name, v in fitted.values.items() if name.endswith(".noise_T")}
    start_at = plain.start_with(rig) | noises | values
    return fit_rig(rig, plain.observations, start_at, plain.posterior.model.rules)

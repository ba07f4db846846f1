"""Asks the readings what is wrong: all of them, by full fits as far as these bear it out, and halves of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.climb import SAMPLING, climbed
from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.found import Found
from estimator.diagnosis.mixture.full_fits import fit_beside_departures, fit_to, leading_fit
from estimator.diagnosis.mixture.halves import blocks_of, expected_in_half, halves, weight_of
from estimator.diagnosis.mixture.rivals import Rival, contenders, rival
from estimator.diagnosis.mixture.slots import NEGLIGIBLE, Samples, Slots, Sweeps
from estimator.diagnosis.progress import OnProgress, Pace, unwatched
from estimator.effects.use import as_meant
from estimator.rig.rig import Cause
from estimator.side_by_side import each

N_PAIRS = 3  # of complementary halves
IN_HALVES = Sweeps(16, 4)
# Log evidence by which fits without a cause are so far behind that rough ones tell it, and the tolerance of these
FAR, FAR_TOLERANCE = 100.0, 0.3


def answer(
    plain: Fit, limits: Limits, seed: int, n_pairs: int = N_PAIRS, on_progress: OnProgress = unwatched
) -> Answer:
    """Ask the readings of a fit what is wrong, all of them and halves of them.

    Args:
        plain: Fit of the rig as described.
        limits: Causes that are asked, and the time.
        seed: Of blocks, halves and draws.
        n_pairs: Of complementary halves.
        on_progress: Called after each expansion and each half.
    """
    first, asked = climbed(plain, limits, seed, on_progress)
    return confirmed(first, asked, limits, seed, n_pairs, on_progress)


def confirmed(
    first: Asked,
    asked: Asked,
    limits: Limits,
    seed: int,
    n_pairs: int = N_PAIRS,
    on_progress: OnProgress = unwatched,
) -> Answer:
    """What leads in all readings, as far as full fits bear it out, and what leads in halves of them.

    Args:
        first, asked: Of a climb.
        limits, seed, n_pairs, on_progress: As in `answer`.
    """
    plain = asked.expansion.plain
    draft = _borne_out(Answer(first, asked), seed)
    asked = draft.asked
    pace = Pace("what leads, in halves of the readings", on_progress)
    numbers = [i for i, largest in enumerate(asked.samples.largest) if largest > NEGLIGIBLE]
    few = asked.dictionary.restricted(numbers)
    readings = as_meant(plain.rig, plain.observations)
    block = blocks_of(readings, plain.rig, seed)
    leading = list(asked.leading)
    few_leading = [numbers.index(item) for item in leading]
    sizes, _ = asked.slots.products.sizes(leading, asked.noise)

    def asked_in(half: tuple[int, np.ndarray]) -> tuple[Samples, dict[int, float]] | None:
        if limits.is_over:
            return None
        i, is_in = half
        pace.tell(i, 2 * n_pairs)
        products = Products(few, weight_of(is_in, readings.is_measured))
        slots = Slots(products, asked.slots.noise, asked.slots.n_slots)
        samples = slots.sample(IN_HALVES, seed + i, (), few_leading).renumbered(
            numbers, len(asked.dictionary.items)
        )
        return samples, expected_in_half(slots, few_leading, sizes, asked.noise_number)

    in_halves = [of_half for of_half in each(asked_in, enumerate(halves(block, n_pairs, seed))) if of_half]
    mean = {
        item: sum(expected[few] for _, expected in in_halves) / len(in_halves)
        for item, few in zip(leading, few_leading, strict=True)
        if in_halves
    }
    ended_early = limits.words if limits.is_over else ""
    samples = tuple(samples for samples, _ in in_halves)
    result = replace(draft, in_halves=samples, expected=mean, ended_early=ended_early)
    return result if ended_early else with_rivals(result)


def _borne_out(draft: Answer, seed: int) -> Answer:
    """The answer without the causes that full fits do not bear out."""
    asked = draft.asked
    while (cause := _not_borne_out(draft)) is not None:
        refused = draft.refused | {cause}
        draft = replace(draft, asked=asked.without(refused, seed, SAMPLING), refused=refused)
    return draft


def _not_borne_out(answer: Answer) -> Cause | None:
    """The stated cause that full fits bear out least, if they do not: with it the evidence must be clearly higher.

    They are fits to the readings without the departures that lead, which would hide what a cause changes beside them.
    """
    stated = [entry.first_listed for entry in answer.stated]
    if not stated:
        return None
    without = {cause: [other for other in stated if other != cause] for cause in stated}
    readings = leading_fit(answer).observations

    def with_all_or_roughly(left_out: Cause | None) -> Fit:
        if left_out is None:
            return fit_beside_departures(answer, stated)
        return fit_to(answer, without[left_out], readings, tolerance=FAR_TOLERANCE)

    own, *rough = each(with_all_or_roughly, [None, *(stated if len(stated) > 1 else [])])
    if rough and all(map(own.still_has, stated)):
        highest = max(fit.log_evidence for fit in rough)
        if own.log_evidence - highest > policy.CLEAR_LOG_EVIDENCE + FAR:
            return None
    others = each(lambda cause: fit_beside_departures(answer, without[cause]), stated)
    rises = {c: own.log_evidence - other.log_evidence for c, other in zip(stated, others, strict=True)}
    least = min(rises, key=rises.__getitem__)
    is_clear = rises[least] > policy.CLEAR_LOG_EVIDENCE and own.still_has(least)
    return None if is_clear else least


def with_rivals(answer: Answer) -> Answer:
    """The answer in which the stated causes have been compared with the likeliest others by full fits."""
    asked, items = answer.asked, answer.asked.dictionary.items
    stated = [entry.first_listed for entry in answer.stated]
    pairs = [
        (cause, item)
        for entry, cause in zip(answer.stated, stated, strict=True)
        for item in _contenders(answer, entry)
    ]
    if not pairs:
        return answer

    def fit_of(pair: tuple[Cause, int]) -> Fit:
        rest, other = [cause for cause in stated if cause != pair[0]], items[pair[1]]
        return fit_to(
            answer, [*rest, other.cause], leading_fit(answer).observations, {other.cause: other.start}
        )

    own, fits = fit_beside_departures(answer, stated), each(fit_of, pairs)
    numbers, rivals = {cause: answer.item_of(cause) for cause in stated}, dict[Cause, tuple[Rival, ...]]()
    for (cause, item), fit in zip(pairs, fits, strict=True):
        fitted = rival(asked, item, fit, numbers, own)
        if fitted.odds > policy.ALTERNATIVE:
            rivals[cause] = (*rivals.get(cause, ()), fitted)
    return replace(answer, rivals=rivals)


def _contenders(answer: Answer, entry: Found) -> list[int]:
    """Items of causes that may be rivals of a stated one: neither there beside it, nor possible only beside others."""
    leading = answer.asked.causes_of(answer.asked.leading)
    return contenders(answer.in_place_of(entry), entry.first_listed, leading | answer.only_beside)

"""Asks what is wrong, moves the expansion to what leads, and asks again until the leading causes stay."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import causes_of
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.departures import Changes, departures
from estimator.diagnosis.mixture.dictionary import dictionary
from estimator.diagnosis.mixture.evidence import Products
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.items import Item
from estimator.diagnosis.mixture.links import Link
from estimator.diagnosis.mixture.listed import Offered, again, offered, places_in, present_items, starts_of
from estimator.diagnosis.mixture.slots import NoisePrior, Slots, Sweeps
from estimator.diagnosis.progress import OnProgress, Pace, unwatched
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause
from estimator.side_by_side import each

MOST_EXPANSIONS = 6
MOST_STARTS = 4  # of fits with a second piece
CLIMBING, SAMPLING = Sweeps(12, 4), Sweeps(40, 10)


def climbed(
    plain: Fit,
    limits: Limits,
    seed: int,
    on_progress: OnProgress = unwatched,
    before: Asked | None = None,
) -> tuple[Asked, Asked]:
    """The readings, asked about the rig as described, and about the expansion at which the leading set of items is most probable.

    Args:
        plain: Fit of the rig as described.
        limits: Causes that are asked, and the time.
        seed: Of the draws.
        on_progress: Called after each expansion.
        before: What led when the same readings were asked with another noise.
    """
    pace = Pace("what leads, in all readings", on_progress)
    pace.tell(0, MOST_EXPANSIONS)
    last = ask(Expansion.of(plain), limits, seed, {}, before)
    first = replace(last, changes=None)
    known = () if before is None else before.expansion.causes
    best, excluded = list[Asked](), set[Cause]()
    seen, shapes = {(frozenset[Cause](), False)}, dict[Cause, dict[str, float]]()
    for n in range(1, MOST_EXPANSIONS):
        pace.tell(n, MOST_EXPANSIONS)
        some = one_more_of_each_link(last, last.leading, known)
        new = frozenset[Cause]()
        is_beside = any(not last.dictionary.items[i].is_listed for i in some)
        for causes, chosen in {last.causes_of(i): i for i in (some, one_more(last, some))}.items():
            if (causes, is_beside) in seen or limits.is_over:
                continue
            moved = last.moved(chosen)
            there = ask(moved, limits, seed, shapes, last).without(excluded, seed, CLIMBING)
            new = causes.difference(last.expansion.causes)
            if not (new and there.is_worse_than(last, {last.dictionary.items[i].cause for i in chosen})):
                break
        else:
            if not new:
                break
            excluded |= new  # what the linear model said of the clearest one does not hold
            last = last.without(excluded, seed, CLIMBING)
            continue
        seen.add((causes, is_beside))
        best, last = [replace(_likeliest([*best, last]), changes=None)], there
        shapes |= {start.candidate.cause: start.candidate.shapes for start in moved.present}
    there = _likeliest([*best, last])
    there = _likeliest([there, *one_for_all(first, there, limits, seed)])
    there = _likeliest([there, *without_departures(there, limits, seed, shapes)])
    return first, replace(there, samples=there.slots.sample(SAMPLING, seed, there.leading))


def one_for_all(first: Asked, there: Asked, limits: Limits, seed: int) -> list[Asked]:
    """The readings asked about the best fit with one cause in place of all that lead, where a linear model foretells as much of it.

    Where the rig as described is far from the readings, its linear model may put several causes before the one that is there.
    """
    items, listed = first.dictionary.items, there.causes_of(there.leading)
    if len(there.leading) != len(listed) or len(listed) < 2 or limits.is_over:
        return []
    gain = there.expansion.fit.log_evidence - first.expansion.fit.log_evidence
    evidence = first.slots.evidence((), first.noise_number)
    alone = dict[Cause, int]()
    for i in evidence.argsort(descending=True).tolist():
        if items[i].is_listed and items[i].cause not in listed and float(evidence[i]) > gain:
            alone.setdefault(items[i].cause, i)
    fits = list(each(lambda i: first.moved([i]), [*alone.values()][:MOST_STARTS]))
    best = max(fits, key=lambda at: at.fit.log_evidence, default=there.expansion)
    if best.fit.log_evidence <= there.expansion.fit.log_evidence:
        return []
    return [ask(best, limits, seed, {}, first)]


def without_departures(
    there: Asked, limits: Limits, seed: int, shapes: Mapping[Cause, dict[str, float]]
) -> list[Asked]:
    """The readings asked about the fit with the listed causes that lead beside departures, and on while what leads becomes more probable.

    Departures follow in one step what several causes do of which only some were fitted; beside all of them they lead no more.
    """
    asked = [there]
    for _ in range(MOST_EXPANSIONS):
        at, items = asked[-1], asked[-1].dictionary.items
        listed = [i for i in at.leading if items[i].is_listed]
        has_all = (
            len(listed) == len(at.leading) if at is there else at.causes_of(listed) == {*at.expansion.causes}
        )
        is_worse = len(asked) > 1 and at.log_density <= asked[-2].log_density
        if not listed or has_all or is_worse or limits.is_over:
            break
        asked.append(ask(at.moved(listed), limits, seed, shapes, at))
    if len(asked) > 1 and {*asked[1].expansion.causes} & _repeated(asked[1]):
        asked += with_one_more(asked[1], limits, seed, shapes)
    return asked[1:]


def with_one_more(
    alone: Asked, limits: Limits, seed: int, shapes: Mapping[Cause, dict[str, float]]
) -> list[Asked]:
    """The readings asked about the best fit with a second piece of what it has.

    The first piece then stands between the two, so that departures follow in one step what only a fit that moves both can explain.
    """
    items, present = alone.dictionary.items, _present(alone.dictionary.items, alone.expansion, ())
    evidence = alone.slots.products.beside(present, alone.noise) + alone.slots.log_prior
    clearest = dict[str, int]()
    for i in evidence.argsort(descending=True).tolist():
        if items[i].repeated and items[i].cause not in alone.expansion.causes and len(clearest) < MOST_STARTS:
            clearest.setdefault(str(items[i].start), i)
    fits = [at for at in each(lambda i: alone.moved([*present, i]), clearest.values()) if not at.has_idle]
    if not fits:
        return []
    likeliest = max(fits, key=lambda at: at.fit.log_evidence)
    return [ask(likeliest, limits, seed, shapes, alone)]


def _repeated(asked: Asked) -> set[Cause]:
    """Causes that may be there twice."""
    names = {effect.repeats.name for effect in EFFECTS.values() if effect.repeats}
    return {item.cause for item in asked.dictionary.items if item.cause.name in names}


def _likeliest(asked: Sequence[Asked]) -> Asked:
    """The one whose leading set is the most probable; one that has all leading causes is preferred. The others need no memory any more."""
    return max(asked, key=lambda at: at.log_density + (policy.LIKED_BY if at.is_fitted else 0.0))


def ask(
    expansion: Expansion,
    limits: Limits,
    seed: int,
    shapes: Mapping[Cause, dict[str, float]],
    before: Asked | None = None,
) -> Asked:
    """What is wrong, by readings that are linear about an expansion.

    Args:
        expansion: The fit.
        limits: Causes that are asked.
        seed: Of the draws.
        shapes: Those that earlier fits have found, by cause.
        before: At the expansion before.
    """
    fit, alone = expansion.fit, expansion.alone
    causes = causes_of(fit.rig, fit, limits)
    led, known = [] if before is None else [before.dictionary.items[i] for i in before.leading], dict(shapes)
    changes = None if before is None else before.changes
    is_near = changes is not None and changes.is_near(fit)
    if before is not None and is_near:
        known = {**places_in(fit, before.dictionary.items), **shapes}
    if changes is None or not is_near:
        changes = Changes.about(expansion, causes)
    here = changes.moved(expansion, causes)
    starts = starts_of(fit, here.pool)
    starts += [more for cause, of_cause in known.items() for more in again(fit, starts, cause, of_cause)]
    listed = offered(alone, starts, is_near)
    if expansion.causes:
        listed = _joined(listed, offered(fit, starts)) + present_items(expansion.present)
    others = list({id(item.start.candidate): item.start.candidate for item in listed}.values())
    entries = dictionary(expansion, listed, departures(here, alone, others))
    slots = Slots(Products(entries), noise_prior(fit), limits.n_slots(fit.rig))
    samples = slots.sample(
        CLIMBING, seed, [*_present(entries.items, expansion, led), *_alike(entries.items, led)]
    )
    return Asked(expansion, here.pool, entries, changes, slots, samples)


def _present(items: Sequence[Item], expansion: Expansion, led: Sequence[Item]) -> list[int]:
    """Numbers of the items of causes that a fit has and that did not lead before, each with as many quantities as there are."""
    known = {item.cause for item in led}
    return [
        max((i for i, item in enumerate(items) if item.cause == cause), key=lambda i: len(items[i].columns))
        for cause in expansion.causes  # in their order: that of a set differs from process to process
        if cause not in known
    ]


def _alike(items: Sequence[Item], led: Sequence[Item]) -> list[int]:
    """Numbers of the items that are most like some of another expansion; none for what has no cause with the same quantities."""
    result = list[int]()
    for before in led:
        same = [i for i, item in enumerate(items) if (item.cause, item.keys) == (before.cause, before.keys)]
        if same:
            result.append(min(same, key=lambda i: abs(math.log(items[i].widths[0] / before.widths[0]))))
    return result


def one_more_of_each_link(asked: Asked, model: Sequence[int], known: Collection[Cause] = ()) -> list[int]:
    """A set of items without causes that the expansion lacks, but for the clearest one at each link of the chain.

    Causes at one link change each other's columns. Those that have led at another noise are known to stand beside each other.
    """
    clearest = dict[Link, int]()
    for i in asked.new_in(model, known):
        clearest.setdefault(asked.dictionary.items[i].link, i)
    others = set(asked.new_in(model, known)).difference(clearest.values())
    return [i for i in model if i not in others]


def one_more(asked: Asked, model: Sequence[int]) -> list[int]:
    """A set of items without causes that the expansion lacks, but for the clearest one."""
    others = asked.new_in(model)[1:]
    return [i for i in model if i not in others]


def noise_prior(fit: Fit) -> NoisePrior:
    """What the rig says of the noise, as a factor on that of a fit: the mean over sensors, as wide as the widest.

    One that is stated as known may be misstated: else departures would follow what it does not.
    """
    parameters = [fit.rig.parameters[f"{sensor.name}.noise_T"] for sensor in fit.rig.sensors]
    apart = [math.log(float(p.value) / float(fit.values[p.name])) for p in parameters]
    width = max(fit.noise_widths, default=0.0)
    return NoisePrior(
        math.exp(sum(apart) / len(apart)), width, p_misstated=0.0 if width else policy.MISSTATED
    )


def _joined(first: Sequence[Offered], second: Sequence[Offered]) -> list[Offered]:
    """Both, each once: those of one start that was asked twice are the same."""
    keys = {_key(item) for item in first}
    return [*first, *(item for item in second if _key(item) not in keys)]


def _key(one: Offered) -> tuple[object, ...]:
    candidate = one.start.candidate
    return candidate.cause, tuple(sorted(candidate.shapes.items())), one.subset, one.width

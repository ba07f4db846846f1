"""The causes: what is wrong, how sure that is, what else it may be, what it costs, and how large it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from estimator.diagnosis.intervals import CLEAR_SD
from estimator.diagnosis.mixture.links import Link
from estimator.diagnosis.panel_records import Answer
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.sizes import Interval, SizedCause
from estimator.diagnosis.statements.left import doubts, p_nothing, unexplained
from estimator.diagnosis.statements.visible import PLACE, would_have_shown
from estimator.diagnosis.verdict import UNKNOWN, NamedCause, Verdict
from estimator.effects import EFFECTS
from estimator.effects.base import Kind
from estimator.effects.circumstances import SINCE, UNTIL, Extent
from estimator.reporting.numbers import percent, probability, quantity_words, to_digit_of
from estimator.reporting.page import Table
from estimator.rig.rig import Cause

NOTHING_WRONG = "These readings show nothing wrong"
MOST_SIZES = 2  # of a cause, that the headline tells
MOST_SPREAD = 0.05  # of a share by the order in which causes are added, up to which one number tells it
LEAST_SHARE = 0.005  # of the misfit, that is told as a percentage
LEAST_DOUBT = 0.1  # of a name, from which on its link is told
MOST_ALTERNATIVES = 4  # that a sentence lists; the others stand in diagnosis.json


def what(diagnosis: Diagnosis) -> Iterator[str]:
    """What is wrong, where, and how sure that is."""
    is_flagged = diagnosis.verdict is Verdict.NAMED and is_only_flagged(diagnosis)
    if is_flagged or diagnosis.verdict is Verdict.NOTHING_FOUND:
        words, readings = ("Nothing else shows", "these readings") if is_flagged else (NOTHING_WRONG, "they")
        how_sure = probability(p_nothing(diagnosis))
        yield doubts(diagnosis) or f"{words} ({how_sure}){would_have_shown(diagnosis, readings)}."
    else:
        mistakes = [_mistake(diagnosis, named) for named in diagnosis.record_mistakes]
        is_unexplained = diagnosis.verdict is Verdict.UNEXPLAINED
        yield from [unexplained(diagnosis), *mistakes] if is_unexplained else [*mistakes, *_stated(diagnosis)]


def _mistake(diagnosis: Diagnosis, named: NamedCause) -> str:
    """A mistake of the record with what its numbers mean; with its probability where it may be another."""
    label, others = diagnosis.label(named.cause), _others(diagnosis, named)
    how_sure = f", {probability(named.probability)}" if others else ""
    effect, sizes = EFFECTS[named.cause.name], diagnosis.quantities(named.cause)
    meaning = effect.meaning({key: size.median for key, size in sizes.items()}) if sizes else ""
    return f"{_capital(effect.words)} ({label}{how_sure}){f': {meaning}' if meaning else ''}{others}."


def is_only_flagged(diagnosis: Diagnosis) -> bool:
    """Whether nothing is wrong but readings that were flagged."""
    return bool(diagnosis.findings.flags) and not (diagnosis.causes or diagnosis.record_mistakes)


def _stated(diagnosis: Diagnosis) -> Iterator[str]:
    """One sentence for each stated cause, with what else it may be; several places of one cause in one, for the least sure of them."""
    for name in dict.fromkeys(named.cause.name for named in diagnosis.causes):
        same = [named for named in diagnosis.causes if named.cause.name == name]
        label = diagnosis.label(same[0].cause)
        if len(same) > 1:
            label = f"{name}[{', '.join(named.cause.place for named in same)}]"
        least = min(same, key=lambda named: named.probability)
        share = _share(diagnosis, [named.cause for named in same])
        how_sure, others = probability(least.probability), _others(diagnosis, least)
        words = f"{_family(least)}{EFFECTS[name].words} ({label}, {how_sure}){others}."
        yield f"{_capital(words)}{share}"


def _family(named: NamedCause) -> str:
    """The link at which it acts, told where the name is doubtful."""
    family = named.family
    if family is None or named.p_not_in_library < LEAST_DOUBT:
        return ""
    links = " or ".join(Link(link).words for link in family.links)
    return f"something is wrong with {links} ({probability(family.probability)}): "


def _others(diagnosis: Diagnosis, named: NamedCause) -> str:
    others = [
        f"{EFFECTS[o.cause.name].words} ({diagnosis.label(o.cause)}, {probability(o.probability)})"
        for o in named.alternatives[:MOST_ALTERNATIVES]
    ]
    if (n_more := len(named.alternatives) - len(others)) > 0:
        others.append(f"{n_more} more causes")
    if named.p_not_in_library >= 0.005:
        others.append(f"{UNKNOWN} ({probability(named.p_not_in_library)})")
    return "".join(f", or {other}" for other in others)


def _share(diagnosis: Diagnosis, causes: Sequence[Cause]) -> str:
    """How much of the misfit some causes account for; empty where no budget tells it."""
    budget = diagnosis.fits.budget
    known = [] if budget is None else [budget.causes[cause] for cause in causes if cause in budget.causes]
    if not known:
        return ""
    subject = "It accounts" if len(causes) == 1 else "They account"
    share = sum(share.value for share in known)
    of_it = "none" if share < LEAST_SHARE else "all" if share > 1.0 - LEAST_SHARE else percent(share)
    if budget is not None and not budget.has_all_orders:
        low, high = (max(sum(share.ci90[end] for share in known), 0.0) for end in (0, 1))
        if high - low > MOST_SPREAD:
            of_it = f"{100.0 * low:.0f} to {percent(min(high, 1.0))}"
    return f" {subject} for {of_it} of the misfit of unseen readings."


def how_large(diagnosis: Diagnosis) -> Iterator[str]:
    """The sizes of the named causes; none where no cause has a clear one."""
    named = [sized for sized in diagnosis.sized_causes if not sized.is_record_mistake]
    told = [(sized.name, ", ".join(words)) for sized in named if (words := _clear_sizes(sized, diagnosis))]
    each = "; ".join(words if len(named) == 1 else f"{name} {words}" for name, words in told)
    if each:
        yield f"Size, with 90 % credible intervals: {each}."


def _clear_sizes(sized: SizedCause, diagnosis: Diagnosis) -> list[str]:
    """The clearest numbers of a cause with their 90 % intervals, when it began, and its place if it has one."""
    quantities, effect = sized.quantities, EFFECTS[sized.cause.name]
    shapes = {quantity.key for quantity in effect.quantities(Extent()) if quantity.is_shape}
    clear = sorted(
        (-abs(interval.median) / interval.sd, key, f"{name} {interval.words}")
        for (name, interval), key in zip(sized.sizes, quantities, strict=True)
        if key not in shapes and abs(interval.median) > CLEAR_SD * interval.sd > 0.0
    )
    words = [] if sized.difference is None else [sized.difference.words]
    words += [size for *_, size in clear[: MOST_SIZES - len(words)]]
    when_h = [quantities[key].median for key in (SINCE, UNTIL) if key in quantities]
    if when_h:
        words.append(diagnosis.fits.plain.observations.instants_in_words(when_h))
    where = [quantities[key] for key in PLACE if key in shapes and key in quantities]
    if len(where) == len(PLACE):
        each = (to_digit_of(1e3 * at.sd, 1e3 * at.median) for at in where)
        frame = "room" if effect.kind is Kind.ROOM else f"frame of {sized.cause.place}"
        words.append(f"at ({', '.join(each)}) mm in the {frame}")
    return words


def answer(sized: SizedCause) -> Answer:
    """A cause as the page of the service shows it."""
    sizes = [f"{name} {interval.words}" for name, interval in sized.sizes if interval.sd > 0.0]
    sizes += [] if sized.difference is None else [sized.difference.words]
    place, kind = sized.cause.place, str(EFFECTS[sized.cause.name].kind)
    return Answer(sized.name, place, kind, sized.words, sized.probability, sizes, list(sized.others))


def found_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Quantities of the causes of the extended rig that are sure enough."""
    sure = [cause for cause in diagnosis.fits.final.rig.effects if cause not in diagnosis.findings.stand_ins]
    before = diagnosis.fits.plain.rig.effects
    caption = (
        "Quantities of the causes in the extended rig (rig_extended.yaml). A difference, such as x − z, is listed where the readings know "
        "it better than either quantity. What stands with (prior) is mostly what its prior says."
    )
    yield from _sizes_tables(diagnosis, [c for c in sure if c not in before], "What was found", caption)
    known = "Fitted before any other cause was tried: causes that the rig file states, and the field and zeros that every laboratory has."
    yield from _sizes_tables(
        diagnosis, [c for c in sure if c in before], "Causes of the rig as described", known
    )


def stand_in_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Quantities of the causes that are not."""
    caption = "Their quantities in the extended rig (rig_extended.yaml), where they were fitted too."
    title = "Causes that are not sure enough to be stated"
    yield from _sizes_tables(diagnosis, diagnosis.findings.stand_ins, title, caption)


def _sizes_tables(diagnosis: Diagnosis, causes: Sequence[Cause], title: str, caption: str) -> Iterator[Table]:
    """A table of the quantities of some causes; none where they have no quantities."""
    differences = {sized.cause: sized.difference for sized in diagnosis.sized_causes}
    rows = []
    for cause in causes:
        quantities = diagnosis.quantities(cause)
        rows += [
            _size_row(
                diagnosis.label(cause), quantity_words(key, quantities), f"{cause.label}.{key}", interval
            )
            for key, interval in quantities.items()
        ]
        if (known := differences.get(cause)) is not None:
            rows.append(
                _size_row(diagnosis.label(cause), known.name, f"{cause.label}.{known.minus}", known.interval)
            )
    if rows:
        yield Table(
            title, ["cause", "quantity", "value ± sd", "90 % credible interval", "unit"], rows, caption
        )


def _size_row(label: str, quantity: str, name: str, interval: Interval) -> list[str]:
    shown = interval.display(name)
    sizes = shown.with_sd(interval.median, interval.sd), shown.interval(interval.ci90, interval.sd)
    if interval.sd == 0.0:
        sizes = f"{interval.median * shown.factor:.3g}", "not sampled"
    name_of_it = f"{quantity} (prior)" if interval.is_of_prior else quantity
    return [label, name_of_it, *sizes, shown.unit or interval.unit]


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]

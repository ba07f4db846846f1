"""The first box of a report: what is wrong and how sure that is, what it cost, and what to do next, in a few sentences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps

import numpy as np

from estimator.calibration.quality import tensions
from estimator.diagnosis import policy
from estimator.diagnosis.gain_in_words import gained, misses
from estimator.diagnosis.mixture.answer import Found
from estimator.diagnosis.mixture.comparison import NOTHING
from estimator.diagnosis.next_readings.resolution import Visible
from estimator.diagnosis.part_by_part import part_by_part
from estimator.diagnosis.result import EXTENDED_RIG, Diagnosis, label_of
from estimator.diagnosis.sizes import Difference
from estimator.diagnosis.structure.pull import pull_of
from estimator.diagnosis.verdict import UNKNOWN, NamedCause, Verdict
from estimator.diagnosis.what_shows import PLACE, hidden_words
from estimator.effects import EFFECTS, ORDER
from estimator.effects.base import Kind
from estimator.effects.circumstances import SINCE, UNTIL, Extent
from estimator.readings.flags import COMPONENTS, told
from estimator.readings.observations import SECONDS_PER_HOUR
from estimator.reporting.numbers import (
    displays,
    interval_with_unit,
    odds,
    percent,
    probability,
    quantity_words,
    size_with_unit,
    to_digit_of,
)
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause

MOST_SIZES = 2
MOST_OF_PRIOR = 0.95  # of a prior's sd: what is wider was hardly seen by the readings
MOST_BESIDE = 2  # possibilities that are told of one thing beside the stated causes
LEAST_SHARE = 0.005  # of the misfit, that is told as a percentage
MOST_OF_MANY = 3  # listed causes that are told where too much is wrong at once
MOST_TENSIONS = 3  # that are listed one by one
MOST_ALTERNATIVES = 4  # that the first sentence lists; the others stand in diagnosis.json


def headline(diagnosis: Diagnosis) -> list[str]:
    """The sentences, most important first."""
    parts = (_flagged, _what, _beside, _how_large, _outliers, gained, _next, _ended_early)
    sentences = part_by_part([_listed(part) for part in parts], diagnosis, lambda fault: fault)
    return [sentence for sentence in sentences if sentence]


def _listed(part: Callable[[Diagnosis], str]) -> Callable[[Diagnosis], list[str]]:
    @wraps(part)
    def listed(diagnosis: Diagnosis) -> list[str]:
        return [part(diagnosis)]

    return listed


def _ended_early(diagnosis: Diagnosis) -> str:
    ended = diagnosis.findings.answer.ended_early
    return f"The diagnosis ended early, for {ended}; the same command goes on with it." if ended else ""


def tension_words(diagnosis: Diagnosis) -> str:
    """Numbers of the rig file that lie far from what it expects of them, even with the causes that were found; empty where none does."""
    values = {name: float(value) for name, value in diagnosis.fits.final.values.items()}
    if diagnosis.posterior is not None:  # whole loop counts may pull other numbers farther than real ones do
        values |= {name: float(np.median(draws)) for name, draws in diagnosis.posterior.draws.items()}
    far = tensions(diagnosis.rig.free, values)
    if not far:
        return ""
    rest = f" {len(far) - MOST_TENSIONS} more numbers lie as far." if len(far) > MOST_TENSIONS else ""
    return f"Far from what the rig file expects: {' '.join(far[:MOST_TENSIONS])}{rest}"


def held_back(diagnosis: Diagnosis) -> list[str]:
    """Sizes that would be larger without their priors, by more than their own standard deviation, one sentence each.

    For normal densities the readings alone would say `centre + (median - centre) / (1 - (sd / prior sd)^2)`.
    """
    sentences = []
    for sized in diagnosis.sized_causes:
        for key, interval in sized.quantities.items():
            parameter = diagnosis.extended_rig.parameters.get(f"{sized.cause.label}.{key}")
            prior = parameter.prior if parameter is not None else None
            if not isinstance(prior, Normal) or not 0.0 < interval.sd < MOST_OF_PRIOR * prior.sd:
                continue
            alone = prior.mean + (interval.median - prior.mean) / (1.0 - (interval.sd / prior.sd) ** 2)
            if abs(alone - interval.median) > interval.sd:
                sentences.append(
                    f"The prior of {sized.name} holds its {quantity_words(key)} back: "
                    f"{size_with_unit(interval.median, interval.unit)} with a prior of ± "
                    f"{size_with_unit(prior.sd, interval.unit)}, about {size_with_unit(alone, interval.unit)} without. "
                    "If such a size is possible, state a wider prior in the rig file."
                )
    return sentences


def _flagged(diagnosis: Diagnosis) -> str:
    """Readings that cannot have been measured as they were recorded, and what was done with them; empty where there are none."""
    flags, others = diagnosis.findings.flags, diagnosis.findings.judging_flags
    are_left_out = any(not flag.is_everywhere for flag in flags)
    left_out = "They were left out; what follows is of the others." if are_left_out else ""
    of_others = told(others, diagnosis.sensor_names, " of the session for validation")
    sentences = (
        told(flags, diagnosis.sensor_names),
        left_out,
        of_others,
        "They judge nothing." if others else "",
    )
    return " ".join(words for words in sentences if words)


def _outliers(diagnosis: Diagnosis) -> str:
    """How many components are probably outliers, and which is the farthest; empty where none is."""
    outliers = diagnosis.findings.outliers
    if not outliers:
        return ""
    far = outliers[0]
    where = f"{COMPONENTS[far.component]} of {far.sensor} in reading {far.reading + 1}"
    few = (
        "One component is probably an outlier"
        if len(outliers) == 1
        else f"{len(outliers)} components are probably outliers, the farthest"
    )
    return f"{few}: {where}, {size_with_unit(abs(far.miss_T), 'T')} off."


def _is_only_flagged(diagnosis: Diagnosis) -> bool:
    """Whether nothing is wrong but readings that were flagged."""
    return bool(diagnosis.findings.flags) and not (diagnosis.causes or diagnosis.record_mistakes)


def _what(diagnosis: Diagnosis) -> str:
    """What is wrong, where, and how sure that is."""
    if diagnosis.verdict is Verdict.NAMED and _is_only_flagged(diagnosis):
        return _doubts(diagnosis) or f"Nothing else is wrong{_would_have_shown(diagnosis, 'these readings')}."
    if diagnosis.verdict is Verdict.NOTHING_FOUND:
        return _doubts(diagnosis) or f"These readings show nothing wrong{_would_have_shown(diagnosis)}."
    mistakes = [f"{_capital(words)} ({label})." for label, words in _mistakes(diagnosis)]
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        return " ".join([_unexplained(diagnosis), *mistakes])
    return " ".join([*mistakes, *stated_causes(diagnosis)])


def _unexplained(diagnosis: Diagnosis) -> str:
    """Says that something is wrong, how much, and whether causes are probable."""
    if _is_pulled(diagnosis):
        name, widths = _pulled(diagnosis)
        why = f"the readings alone would put {name} {widths:.2g} widths of its prior from what the rig file states"
    elif diagnosis.findings.scatter.is_probable and not diagnosis.findings.answer.leaves_something:
        why = f"how far readings miss depends on {_plain(diagnosis.findings.scatter.along)}"
    else:
        why = misses(diagnosis)
    is_probable = any(entry.first.is_listed for entry in diagnosis.findings.answer.beside)
    unknown = "no cause is sure enough to be stated" if is_probable else "no known cause explains it"
    return f"Something is wrong, and {unknown}: {why}."


def stated_causes(diagnosis: Diagnosis) -> list[str]:
    """One sentence for each stated cause, with what else it may be; several places of one cause in one sentence."""
    sentences = []
    for name in dict.fromkeys(named.cause.name for named in diagnosis.causes):
        same = [named for named in diagnosis.causes if named.cause.name == name]
        first = same[0]
        label = diagnosis.label(first.cause)
        if len(same) > 1:
            label = f"{name}[{', '.join(named.cause.place for named in same)}]"
        least = min(named.probability for named in same)
        sentences.append(
            f"{_capital(EFFECTS[name].words)} ({label}, {probability(least)}){_others(diagnosis, first)}."
            f"{_share(diagnosis, [named.cause for named in same])}"
        )
    return sentences


def _share(diagnosis: Diagnosis, causes: Sequence[Cause]) -> str:
    """How much of the misfit some causes account for; empty where no budget tells it."""
    budget = diagnosis.fits.budget
    known = [] if budget is None else [budget.causes[cause] for cause in causes if cause in budget.causes]
    if not known:
        return ""
    subject = "It accounts" if len(causes) == 1 else "They account"
    share = sum(share.value for share in known)
    of_it = "none" if share < LEAST_SHARE else "all" if share > 1.0 - LEAST_SHARE else percent(share)
    return f" {subject} for {of_it} of the misfit of unseen readings."


def _beside(diagnosis: Diagnosis) -> str:
    """What else is probable: first what no list holds, then listed causes that are not sure enough to be stated."""
    answer = diagnosis.findings.answer
    if not diagnosis.verdict.leaves_something:
        return ""
    listed = [entry for entry in answer.beside if entry.first.is_listed]
    if answer.is_full:
        links = [link.words for link, p in answer.unlisted.items() if p > 0.5]
        where = f" Something unlisted is in {', and in '.join(links)}." if links else ""
        some = "; ".join(_words_of(diagnosis, entry) for entry in listed[:MOST_OF_MANY])
        most = f" Most probable, but not stated: {some}." if listed else ""
        them = "the others " if diagnosis.causes else ""
        return f"At least {len(answer.asked.leading)} things are wrong at once, too many to tell {them}apart.{most}{where}"
    unlisted = [_words_of(diagnosis, entry) for entry in answer.beside if not entry.first.is_listed]
    faint = [_words_of(diagnosis, entry) for entry in listed if entry.first_listed not in answer.refused]
    refused = [_words_of(diagnosis, entry) for entry in listed if entry.first_listed in answer.refused]
    sentences = []
    if unlisted:
        sentences.append(f"What is left is best described so: {'; '.join(unlisted)}.")
    elif diagnosis.causes and not listed:
        links = [link.words for link, p in answer.unlisted.items() if p > 0.5]
        where = f"It is in {links[0]}." if links else "The readings do not tell where it sits."
        sentences.append(f"Something else is left that no listed cause explains. {where}")
    if faint:
        sentences.append(f"Not sure enough to be stated: {'; '.join(faint)}.")
    if refused:
        sentences.append(
            f"Probable where readings count as linear, but not borne out by a full fit: {'; '.join(refused)}."
        )
    return " ".join(sentences)


def _words_of(diagnosis: Diagnosis, entry: Found) -> str:
    """The possibilities of a set in words, with their probabilities."""
    return " or ".join(
        f"{EFFECTS[p.cause.name].words} ({label_of(p.cause, diagnosis.rig)}, {probability(entry.probability * p.share)})"
        for p in entry.possibilities[:MOST_BESIDE]
    )


def _doubts(diagnosis: Diagnosis) -> str:
    """Sentence that something probably is wrong where nothing is sure enough to be named; empty where nothing wrong is probable."""
    last = diagnosis.comparisons[-1][1].hypotheses
    nothing = next(hypothesis.probability for hypothesis in last if hypothesis.name == NOTHING)
    if nothing > policy.LEAST_SURE_OF_NOTHING:
        return ""
    others = [hypothesis for hypothesis in last if hypothesis.name != NOTHING][:MOST_ALTERNATIVES]
    names = ", ".join(
        f"{UNKNOWN if h.cause is None else diagnosis.label(h.cause)} {probability(h.probability)}"
        for h in others
    )
    return (
        f"Nothing is sure enough to be named, but it is only {probability(nothing)} probable that nothing is wrong. "
        f"The best other answers: {names}."
    )


def _is_pulled(diagnosis: Diagnosis) -> bool:
    """Whether all that is left unexplained is that a number lies far outside its prior."""
    return diagnosis.findings.pull.is_probable and not diagnosis.findings.answer.leaves_something


def _pulled(diagnosis: Diagnosis) -> tuple[str, float]:
    """The number that is pulled most in the fit that the page shows, and how many widths of its prior the readings would have it off."""
    pull = pull_of(diagnosis.fits.final)
    return displays([parameter.name for parameter in diagnosis.rig.free])[pull.name].words, abs(pull.widths)


def _plain(dependence: str) -> str:
    """What something depends on, without the family that it belongs to.

    Examples:
        >>> _plain("two circumstances, temperature and field strength"), _plain("wandering in time")
        ('temperature and field strength together', 'time, wandering')
    """
    first, _, rest = dependence.partition(", ")
    if first == "two circumstances":
        return f"{rest} together"
    if first == "wandering in time":
        return ", ".join(filter(None, ("time, wandering", rest)))
    return rest if first == "one circumstance" else dependence


def _would_have_shown(diagnosis: Diagnosis, readings: str = "they") -> str:
    """The smallest visible size of the first cause of the library that shows, of a coil, a sensor and a mover each."""
    first: dict[Kind, Visible] = {}
    easiest_first = sorted(diagnosis.left_open.visible, key=lambda visible: visible.size / visible.prior_sd)
    for visible in sorted(easiest_first, key=lambda visible: ORDER[visible.cause.name]):
        if visible.is_visible and not EFFECTS[visible.cause.name].is_record_mistake:
            first.setdefault(EFFECTS[visible.cause.name].kind, visible)
    shown = [
        f"{diagnosis.label(first[kind].cause)} {quantity_words(first[kind].key)} from {size_with_unit(first[kind].size, first[kind].unit)}"
        for kind in (Kind.COIL, Kind.SENSOR, Kind.MOVER)
        if kind in first
    ]
    return f"; {readings} would have shown, for example, {', '.join(shown)}" if shown else ""


def _mistakes(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    causes = [mistake.cause for mistake in diagnosis.record_mistakes]
    return [(diagnosis.label(cause), EFFECTS[cause.name].words) for cause in causes]


def _how_large(diagnosis: Diagnosis) -> str:
    """The sizes of the named causes; empty where none has a clear one."""
    sizes = [(diagnosis.label(named.cause), _sizes(diagnosis, named.cause)) for named in diagnosis.causes]
    sizes = [(label, words) for label, words in sizes if words]
    if len(diagnosis.causes) == 1:
        sizes = [("", words) for _, words in sizes]
    each = [f"{label} {', '.join(words)}".strip() for label, words in sizes]
    return f"Size, with 90 % credible intervals: {'; '.join(each)}." if each else ""


def _sizes(diagnosis: Diagnosis, cause: Cause) -> list[str]:
    """The clearest numbers of a cause with their 90 % intervals, when it began, and its place if it has one."""
    sized = next(sized_cause for sized_cause in diagnosis.sized_causes if sized_cause.cause == cause)
    shapes = {quantity.key for quantity in EFFECTS[cause.name].quantities(Extent()) if quantity.is_shape}
    clear = sorted(
        (-abs(interval.median) / interval.sd, key, interval)
        for key, interval in sized.quantities.items()
        if key not in shapes and abs(interval.median) > policy.CLEAR_SD * interval.sd > 0.0
    )
    words = [] if sized.difference is None else [difference_words(sized.difference)]
    words += [
        f"{quantity_words(key, sized.quantities)} {interval_with_unit(interval.median, *interval.ci90, interval.unit)}"
        for _, key, interval in clear[: MOST_SIZES - len(words)]
    ]
    when_s = [
        f"{SECONDS_PER_HOUR * sized.quantities[key].median:.0f}"
        for key in (SINCE, UNTIL)
        if key in sized.quantities
    ]
    if when_s:
        words.append(f"{' to '.join(when_s)} s after the first reading")
    where = [sized.quantities[key] for key in PLACE if key in shapes and key in sized.quantities]
    if len(where) == len(PLACE):
        each = (to_digit_of(1e3 * at.sd, 1e3 * at.median) for at in where)
        frame = "room" if EFFECTS[cause.name].kind is Kind.ROOM else f"frame of {cause.place}"
        words.append(f"at ({', '.join(each)}) mm in the {frame}")
    return words


def difference_words(difference: Difference) -> str:
    """The difference of two quantities with its 90 % interval."""
    interval = difference.interval
    names = f"{quantity_words(difference.plus)} − {quantity_words(difference.minus)}"
    return f"{names} {interval_with_unit(interval.median, *interval.ci90, interval.unit)}"


def _others(diagnosis: Diagnosis, named: NamedCause) -> str:
    others = [
        f"{EFFECTS[o.cause.name].words} ({diagnosis.label(o.cause)}, {probability(o.probability)})"
        for o in named.alternatives[:MOST_ALTERNATIVES]
    ]
    n_more = len(named.alternatives) - len(others)
    others += [f"{n_more} more causes"] if n_more > 0 else []
    if named.p_not_in_library >= 0.005:
        others.append(f"{UNKNOWN} ({probability(named.p_not_in_library)})")
    return f", or {', or '.join(others)}" if others else ""


def _next(diagnosis: Diagnosis) -> str:
    """What to do next."""
    if diagnosis.left_open.next_measurements:
        best = diagnosis.left_open.next_measurements[0]
        return (
            f"To tell them apart, measure {best.action.words} (expected {odds(best.expected_log_evidence)})."
        )
    if diagnosis.verdict is Verdict.UNEXPLAINED and _is_pulled(diagnosis):
        return f"Check {_pulled(diagnosis)[0]} in the rig file; state a wider prior if such a value is possible, and diagnose again."
    if (correction := diagnosis.fits.correction) is not None and correction.is_taken:
        return correction.words(diagnosis.label)
    if diagnosis.verdict.leaves_something:
        return "Intervals are widened by what is left; look at the residual below before you rely on predictions."
    if diagnosis.verdict is Verdict.NAMED and _is_only_flagged(diagnosis):
        return "Put the record right, and see what wrote it; the rig file is right as it is."
    if diagnosis.verdict is Verdict.NAMED:
        return f"Use {EXTENDED_RIG} in place of the rig file, or mend the cause and measure again."
    if diagnosis.verdict is Verdict.NOTHING_FOUND:
        if _doubts(diagnosis):
            return "Measure again, with more readings, before you rely on the rig file as it is."
        hidden = hidden_words(diagnosis)
        if hidden:
            return f"{hidden} Where nothing of that kind can be, use the rig file as it is."
        return "Nothing that these readings show asks for another rig file."
    if any(cause.may_be_unknown for cause in diagnosis.causes):
        return (
            f"The readings leave room for something that no list holds: mend the cause, or use {EXTENDED_RIG}, and measure again. "
            "What is true stands out more clearly with more readings."
        )
    return ""


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]

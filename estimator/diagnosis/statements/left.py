"""What is left: something wrong that no stated cause explains, what describes it best, and what other readings would allow to correct."""

from __future__ import annotations

from collections.abc import Iterator

from estimator.diagnosis.mixture.comparison import NOTHING
from estimator.diagnosis.mixture.found import Found
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.statements.gain import misses
from estimator.diagnosis.statements.residuals import is_extended
from estimator.diagnosis.structure.pull import pull_of
from estimator.diagnosis.verdict import UNKNOWN
from estimator.effects import EFFECTS
from estimator.readings.digits import coarse_steps_T
from estimator.reporting.numbers import displays, odds, probability, size_with_unit
from estimator.reporting.page import Table

# Probability that nothing is wrong, below which `nothing_found` says what is more probable
LEAST_SURE_OF_NOTHING = 0.2

SURELY = 0.95  # probability from which on something is told to be wrong without it
MOST_BESIDE = 2  # possibilities that are told of one thing beside the stated causes
MOST_OF_MANY = 3  # listed causes that are told where too much is wrong at once
MOST_ALTERNATIVES = 4  # other answers that a doubt lists


def unexplained(diagnosis: Diagnosis) -> str:
    """Says that something is wrong, how much, and whether causes are probable."""
    findings = diagnosis.findings
    if is_pulled(diagnosis):
        name, widths = pulled(diagnosis)
        why = f"the readings alone would put {name} {widths:.2g} widths of its prior from what the rig file states"
    elif findings.scatter.is_probable and not findings.answer.leaves_something:
        why = f"how far readings miss depends on {findings.scatter.along.removeprefix('one circumstance, ')}"
        why += _rounded(diagnosis)
    else:
        why = misses(diagnosis)
    is_probable = any(entry.first.is_listed for entry in findings.answer.beside) or bool(
        _withdrawn(diagnosis)
    )
    has_stated = bool(diagnosis.causes or diagnosis.record_mistakes)
    other, something = ("other ", "Something else") if has_stated else ("", "Something")
    unknown = (
        f"no {other}cause is sure enough to be stated"
        if is_probable
        else f"no {other}known cause is probable"
    )
    sure = _how_sure(diagnosis)
    words = (
        f"{something} is wrong" if sure > SURELY else f"{something} is probably wrong ({probability(sure)})"
    )
    return f"{words}, and {unknown}: {why}."


def _how_sure(diagnosis: Diagnosis) -> float:
    """Probability that something is wrong: that of the likeliest thing."""
    findings = diagnosis.findings
    answer = findings.answer
    likeliest = max((entry.probability for entry in answer.found), default=0.0)
    return max(
        likeliest,
        answer.p_unlisted,
        float(answer.is_full),
        *(d.probability for d in (findings.scatter, findings.pull)),
    )


def _rounded(diagnosis: Diagnosis) -> str:
    """Sensors whose last digit is coarser than their noise allows; empty where there are none."""
    fit = diagnosis.fits.plain
    noise_T = [float(fit.values[f"{sensor.name}.noise_T"]) for sensor in fit.rig.sensors]
    return "".join(
        f", and {fit.rig.sensors[i].name} reads in steps of {size_with_unit(step_T, 'T', 3)}, whose rounding is most of its noise"
        for i, step_T in coarse_steps_T(fit.observations, noise_T).items()
    )


def p_nothing(diagnosis: Diagnosis) -> float:
    """Probability that nothing is wrong beside what is stated."""
    last = diagnosis.comparisons[-1][1].hypotheses
    return next(hypothesis.probability for hypothesis in last if hypothesis.name == NOTHING)


def doubts(diagnosis: Diagnosis) -> str:
    """Says that something probably is wrong where nothing is sure enough to be named; empty where nothing wrong is probable."""
    nothing = p_nothing(diagnosis)
    if nothing > LEAST_SURE_OF_NOTHING:
        return ""
    last = diagnosis.comparisons[-1][1].hypotheses
    others = [hypothesis for hypothesis in last if hypothesis.name != NOTHING][:MOST_ALTERNATIVES]
    names = ", ".join(
        f"{UNKNOWN if h.cause is None else diagnosis.label(h.cause)} {probability(h.probability)}"
        for h in others
    )
    return (
        f"Nothing is sure enough to be named, but it is only {probability(nothing)} probable that nothing is wrong. "
        f"The best other answers: {names}."
    )


def beside(diagnosis: Diagnosis) -> Iterator[str]:
    """What else is probable: what no list holds, listed causes that are not sure enough, and those that unseen readings withdraw."""
    if not diagnosis.verdict.leaves_something:
        return
    yield from (sentences for sentences in (_beside_names(diagnosis), _unseen(diagnosis)) if sentences)


def _withdrawn(diagnosis: Diagnosis) -> list[Found]:
    """Sets that the readings hold for sure and that have no name because of unseen readings."""
    named = {each.cause for each in diagnosis.causes}
    stated = diagnosis.findings.answer.stated
    return [entry for entry in stated if not any(p.cause in named for p in entry.possibilities)]


def _unseen(diagnosis: Diagnosis) -> str:
    """Says why sets are withdrawn; empty where none is."""
    shares, withdrawn = diagnosis.fits.budget, _withdrawn(diagnosis)
    small = [e for e in withdrawn if shares is not None and shares.is_negligible(e.first_listed)]
    final = diagnosis.fits.final
    replaced = [
        e
        for e in withdrawn
        if e not in small and e.first_listed in final.rig.effects and final.has_nothing_of(e.first_listed)
    ]
    refuted = [entry for entry in withdrawn if entry not in small and entry not in replaced]
    words = []
    if replaced:
        words.append(
            f"Clear until the rest was corrected, which does the same: {_told(diagnosis, replaced)}."
        )
    if small:
        words.append(f"Clear, but less than 1 % of the misfit of unseen readings: {_told(diagnosis, small)}.")
    if refuted:
        words.append(f"Refuted by unseen readings: {_told(diagnosis, refuted)}.")
    return " ".join(words)


def _beside_names(diagnosis: Diagnosis) -> str:
    """Says what else is probable; empty where nothing is."""
    answer = diagnosis.findings.answer
    listed = [entry for entry in answer.beside if entry.first.is_listed]
    links = [f"{link.words} ({probability(p)})" for link, p in answer.unlisted.items() if p > 0.5]
    if answer.is_full:
        where = f" Something else acts in {', and in '.join(links)}." if links else ""
        most = f" Most probable, but not stated: {_told(diagnosis, listed[:MOST_OF_MANY])}." if listed else ""
        n = len(answer.asked.leading)
        more = "there are more, or one that no list holds and that these imitate"
        return f"Even {n} things wrong at once do not explain the readings: {more}.{most}{where}"
    unlisted = [entry for entry in answer.beside if not entry.first.is_listed]
    refused = [entry for entry in listed if entry.first_listed in answer.refused]
    faint = [entry for entry in listed if entry not in refused]
    sentences = []
    if unlisted:
        sentences.append(f"What is left is best described so: {_told(diagnosis, unlisted)}.")
    elif diagnosis.causes and not listed:
        where = f"It acts in {links[0]}." if links else "The readings do not tell where it acts."
        sentences.append(f"Something else is left, for which no listed cause is probable. {where}")
    if faint:
        sentences.append(f"Not sure enough to be stated: {_told(diagnosis, faint)}.")
    if refused:
        words = "Probable where readings count as linear, but not borne out by a full fit"
        sentences.append(f"{words}: {_told(diagnosis, refused)}.")
    return " ".join(sentences)


def _told(diagnosis: Diagnosis, entries: list[Found]) -> str:
    """Sets of possibilities in words, with their probabilities, and their sizes where they are corrected as a whole."""
    correction = diagnosis.fits.correction
    parts = correction.parts if correction is not None and correction.is_taken else ()
    sizes = {part.cause: f" {part.extent}" for part in parts if part.is_whole}
    return "; ".join(
        " or ".join(
            f"{EFFECTS[p.cause.name].words} ({diagnosis.label(p.cause)}{sizes.get(p.cause, '')}, "
            f"{probability(entry.probability * p.share)})"
            for p in entry.possibilities[:MOST_BESIDE]
        )
        for entry in entries
    )


def is_pulled(diagnosis: Diagnosis) -> bool:
    """Whether all that is left unexplained is that a number lies far outside its prior."""
    return diagnosis.findings.pull.is_probable and not diagnosis.findings.answer.leaves_something


def pulled(diagnosis: Diagnosis) -> tuple[str, float]:
    """The number that is pulled most in the final fit, and how many widths of its prior the readings would have it off."""
    pull = pull_of(diagnosis.fits.final)
    return displays([parameter.name for parameter in diagnosis.rig.free])[pull.name].words, abs(pull.widths)


def evidence(diagnosis: Diagnosis) -> Iterator[str]:
    """Odds that something acts beside what is stated, and that how far readings miss depends on something."""
    left, scatter = diagnosis.findings.answer.left, diagnosis.findings.scatter
    if diagnosis.verdict.leaves_something and left.log_bayes_factor > 0.0:
        odds_of_more = odds(left.log_bayes_factor)
        yield f"{odds_of_more} that something acts beside what is stated; it looks like a change in {left.words}"
    if diagnosis.verdict.leaves_something and scatter.is_probable:
        yield f"{odds(scatter.log_bayes_factor)} that how far readings miss depends on {scatter.along}"


def symptoms_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Tests of the residual before and after the extension."""
    rows = [["before", sentence] for sentence in diagnosis.fits.before.sentences()]
    if is_extended(diagnosis):
        rows += [["after", sentence] for sentence in diagnosis.fits.after.sentences()]
    caption = "Tests of the residual of the readings that were fitted."
    yield Table("Symptoms", ["model", "residual"], rows, caption)


def limits_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """Corrections that could not be asked, or not to a higher degree; no table where there are none."""
    correction = diagnosis.fits.correction
    if correction is None or not correction.limits:
        return
    yield Table(
        "Corrections that other readings would allow",
        ["correction", "meaning", "what these readings lack"],
        [[label, EFFECTS[label.partition("[")[0]].words, lack] for label, lack in correction.limits.items()],
        "These readings allow them to a lower degree only, or not at all. Where places are lacking, coilcal design --map proposes some.",
    )

"""How far the rig as described misses and what the extended rig gains: errors on readings that no fit has seen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.structure.covariates import residual_T
from estimator.diagnosis.validation import Improvement, ValidationScores
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
from estimator.effects.use import is_in_field
from estimator.errors import listed
from estimator.inference.noise_of_readings import noise_words
from estimator.readings.flags import COMPONENTS
from estimator.reporting.numbers import percent, size_with_unit
from estimator.reporting.page import Table
from estimator.rig.rig import Cause

MOST_COVERAGE90 = 0.97  # above which intervals are told to be too wide, unless chance gives as many
# By which 90 % intervals must hold too few or too many readings to be said: chance in one of 700
MISCOVERED_SE = 3.0

# A component is told that has this share of the squares beyond the noise: a fit spreads some over the others
MOSTLY = 0.75
# Of an rms error: no chance of 50 readings, though intervals that are widened may make them no more probable
CLEAR_FALL = 0.8
MOST_BESIDE = 3  # causes that a prediction lacks, one by one


def misses(diagnosis: Diagnosis) -> str:
    """How far the rig as described misses, against the noise, and where most of it is.

    Of readings that no fit has seen, where there are some: what the extended rig leaves of them is told with the gain. Else of those that
    were fitted, by both; the extended rig says more of the noise than the rig file does, which may state more than there is.
    """
    improvement = diagnosis.improvement
    if improvement is None:
        before, after = (symptoms.lack_of_fit for symptoms in (diagnosis.fits.before, diagnosis.fits.after))
        rms_T, of = before.rms_T, "the readings that were fitted"
        noise_T, noise = before.noise_T, noise_words(before.noise_from == "repeats")
    else:
        rms_T, of = improvement.before.errors.vector_T, "readings that no fit has seen"
        noise_T, noise = improvement.before.of_noise()
    rms = f"the rig as described misses {of} by {size_with_unit(rms_T, 'T', 3)} rms"
    if improvement is None and before is not after:
        return f"{rms}, the extended rig by {size_with_unit(after.rms_T, 'T', 3)}{_mostly(diagnosis)}"
    noise_rms = size_with_unit(noise_T, "T", 3)
    if rms_T <= noise_T:
        return f"{rms}, no more than {noise} ({noise_rms}), but not at random"
    return f"{rms} where {noise} {noise_rms}{_mostly(diagnosis)}"


def _mostly(diagnosis: Diagnosis) -> str:
    """The one component of a sensor in which most is wrong; empty where there is none."""
    fit, noise_T = diagnosis.fits.plain, diagnosis.fits.before.lack_of_fit.noise_T
    missed_T = residual_T(fit).nan_to_num()
    excess = {
        f"{axis} of {sensor.name}": float(of_axis.square().sum()) - noise_T**2 * int((of_axis != 0.0).sum())
        for i, sensor in enumerate(diagnosis.rig.sensors)
        for axis, of_axis in zip(COMPONENTS, missed_T[fit.observations.sensor == i].T, strict=True)
    }
    most = max(excess, key=excess.__getitem__)
    total = sum(max(each, 0.0) for each in excess.values())
    return f", mostly in {most}" if excess[most] > MOSTLY * total > 0.0 else ""


def gained(diagnosis: Diagnosis) -> Iterator[str]:
    """What the extension gains on unseen readings."""
    improvement = diagnosis.improvement
    if improvement is None or not diagnosis.fits.extended.rig.acting:
        return
    extended = improvement.after
    errors = extended.predicted if extended.is_of_field else extended.errors
    errors_T = [improvement.before.errors.vector_T, errors.vector_T]
    before, after = (size_with_unit(error_T, "T", 3) for error_T in errors_T)
    unseen = f"On {len(improvement.before.log_density)} readings that no fit has seen the rms error"
    if diagnosis.fits.extended.rig.acting == diagnosis.fits.plain.rig.acting:
        gain = f"is {after}"  # what is left of a difference tells nothing
    elif not improvement.is_significant and errors_T[1] > CLEAR_FALL * errors_T[0]:
        gain = f"does not fall clearly: {before} before, {after} after"
    elif errors_T[1] >= errors_T[0]:  # causes that scatter predict no reading better
        told = f"log predictive density {improvement.elpd_difference:+.0f}"
        gain = f"does not fall ({before} before, {after} after), but how far they miss is told better: {told}"
    else:
        gain = f"falls from {before} to {after}"
    yield f"{unseen} {gain}{_too_sure(extended)}.{_not_of_the_field(diagnosis, improvement)}"


def _too_sure(extended: ValidationScores) -> str:
    """Says that intervals hold clearly too few of the components of unseen readings; empty where they do not."""
    if extended.coverage90 > 0.9 - _chance(extended):
        return ""
    return f", and 90 % intervals hold only {percent(extended.coverage90)} of their components: they are too narrow"


def _chance(scores: ValidationScores) -> float:
    """How far the share of components in 90 % intervals may be off 0.9 by chance, with as many readings as there are."""
    return MISCOVERED_SE * math.sqrt(0.9 * 0.1 / len(scores.log_density))


def _not_of_the_field(diagnosis: Diagnosis, improvement: Improvement) -> str:
    """What readings have beside the predicted field, and how far it misses them without what they alone have; empty where it is all."""
    of_all = _first_few(diagnosis, _in_every_session(diagnosis, improvement))
    instruments = f"what sensors and movers do wrong ({of_all})" if of_all else ""
    if improvement.after.is_of_field:
        return f" It includes {instruments}; predict gives the field without it." if of_all else ""
    of_these = _first_few(diagnosis, improvement.not_predicted)
    error = size_with_unit(improvement.after.predicted.vector_T, "T", 3)
    beside = f" It includes what predictions are without ({of_these}): they" if of_these else " Predictions"
    with_all = f", with {instruments}" if of_all else ""
    field = "; the field itself may be right" if of_these else ""
    return f"{beside} miss these readings by {error}{with_all}{field}."


def _in_every_session(diagnosis: Diagnosis, improvement: Improvement) -> list[Cause]:
    """Causes that change what sensors show, and where, in every session."""
    rig = diagnosis.fits.final.rig
    return [
        cause
        for cause in rig.effects
        if cause not in improvement.not_predicted
        and not is_in_field(rig, cause)
        and not EFFECTS[cause.name].is_record_mistake
        and not isinstance(EFFECTS[cause.name], NoiseEffect)
    ]


def _first_few(diagnosis: Diagnosis, causes: Sequence[Cause]) -> str:
    """Names of some causes, and how many more there are."""
    return listed((diagnosis.label(cause) for cause in causes[:MOST_BESIDE]), len(causes))


def validation_warnings(diagnosis: Diagnosis) -> Iterator[str]:
    """Says that nothing was kept out of the fits, or that intervals hold too few or too many of the unseen readings."""
    improvement = diagnosis.improvement
    if improvement is None:
        yield "No readings were kept out of the fits, so the extension is not validated."
    elif improvement.after.coverage90 > max(MOST_COVERAGE90, 0.9 + _chance(improvement.after)):
        share = percent(improvement.after.coverage90)
        yield f"The 90 % predictive intervals contain {share} of the components of unseen readings: they are too wide."
    elif not diagnosis.fits.extended.rig.acting and (words := _too_sure(improvement.after)):
        yield f"Of readings that no fit has seen{words.removeprefix(', and')}."


def unseen_line(improvement: Improvement, *, is_extended: bool = True) -> str:
    """Error and coverage of the predicted field on unseen readings, and how much more probable they are, in one line."""
    before, after = improvement.before, improvement.after
    if not is_extended:  # a difference is that between the most probable numbers and those of the best draw
        error_uT, coverage = after.predicted.vector_T * 1e6, percent(after.predicted_coverage90, 1)
        return f"unseen readings: {error_uT:.4g} uT rms of the vector; coverage of 90 % intervals {coverage}"
    line = (
        f"unseen readings: {before.errors.vector_T * 1e6:.4g} -> {after.predicted.vector_T * 1e6:.4g} uT rms of the vector; "
        f"coverage of 90 % intervals {percent(before.coverage90, 1)} -> {percent(after.predicted_coverage90, 1)}; "
        f"log predictive density {improvement.elpd_difference:+.1f} +- {improvement.elpd_se:.1f}"
    )
    if after.is_of_field and abs(after.coverage90 - after.predicted_coverage90) <= _chance(after):
        return line
    return (
        f"{line}, with all that these readings alone have: {after.errors.vector_T * 1e6:.4g} uT, coverage "
        f"{percent(after.coverage90, 1)}"
    )


def validation_tables(diagnosis: Diagnosis) -> Iterator[Table]:
    """What is gained on unseen readings; none where no readings were kept out."""
    improvement, correction = diagnosis.improvement, diagnosis.fits.correction
    if improvement is None:
        return
    caption = (
        f"The expected log predictive density (elpd) changes by {improvement.elpd_difference:+.1f} ± {improvement.elpd_se:.1f} "
        "(standard error over readings). The columns in 50 % and in 90 % give the share of components inside those predictive intervals; "
        "the mean angle is over readings with a current. The first error is that of the field that predict gives; the other numbers "
        "include what acts on these readings alone."
    )
    if correction is not None:
        caption += f" {correction.words(diagnosis.label)}"
    header = [
        "model",
        "predicted field",
        "with all of these readings",
        "of rms field",
        "largest",
        "mean angle",
        "in 50 %",
        "in 90 %",
        "elpd",
    ]
    rows = [_scores_row(name, scores) for name, scores in rungs(diagnosis, improvement)]
    yield Table("Improvement on readings not used for fitting", header, rows, caption)


def _scores_row(name: str, scores: ValidationScores) -> list[str]:
    errors, angle = scores.errors, scores.errors.angular_deviation_rad
    return [
        name,
        size_with_unit(scores.predicted.vector_T, "T", 4),
        size_with_unit(errors.vector_T, "T", 4),
        percent(errors.relative, 3),
        size_with_unit(errors.max_T, "T", 4),
        f"{math.degrees(angle):.3f}°" if math.isfinite(angle) else "—",
        percent(scores.coverage50),
        percent(scores.coverage90),
        f"{scores.elpd:.1f}",
    ]


def rungs(diagnosis: Diagnosis, improvement: Improvement) -> list[tuple[str, ValidationScores]]:
    """Scores before and after; where something is corrected, those with the causes alone between them."""
    correction = diagnosis.fits.correction
    before, after = improvement.before, improvement.after
    if correction is None or not correction.is_taken or correction.gain is None:
        return [("before", before), ("after", after)]
    with_causes = correction.gain.before
    if with_causes.errors == before.errors:  # no cause was kept
        return [("before", before), ("corrected, the rest is left", after)]
    return [
        ("before", before),
        ("explained: with the causes", with_causes),
        ("corrected too, the rest is left", after),
    ]

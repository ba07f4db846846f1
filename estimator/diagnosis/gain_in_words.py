"""How far the rig as described misses and what the extended rig gains, in words: errors on readings that no fit has seen."""

from __future__ import annotations

from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.structure.covariates import predicted_T
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.effects.stages import NoiseEffect
from estimator.effects.use import is_in_field
from estimator.readings.flags import COMPONENTS
from estimator.reporting.numbers import size_with_unit
from estimator.rig.rig import Cause, Rig

MOSTLY = (
    0.75  # of the squares beyond the noise, for one component to be told: a fit spreads some over the others
)
MOST_BESIDE = 3  # causes that a prediction lacks, one by one


def misses(diagnosis: Diagnosis) -> str:
    """How far the rig as described misses, against the noise, and where most of it is.

    Of readings that no fit has seen, where there are some: what the extended rig leaves of them is told with the gain. Else of those that
    were fitted, by both; the extended rig says more of the noise than the rig file does, which may state more than there is.
    """
    before, after = (symptoms.lack_of_fit for symptoms in (diagnosis.fits.before, diagnosis.fits.after))
    improvement = diagnosis.improvement
    rms_T, noise_T, of = before.rms_T, before.noise_T, "the readings that were fitted"
    if improvement is not None:
        errors = improvement.before.errors
        rms_T, of = errors.vector_T, "readings that no fit has seen"
        noise_T *= errors.vector_T / errors.component_T if errors.component_T > 0.0 else 1.0
    rms = f"the rig as described misses {of} by {size_with_unit(rms_T, 'T', 3)} rms"
    if improvement is None and before is not after:
        return f"{rms}, the extended rig by {size_with_unit(after.rms_T, 'T', 3)}{_mostly(diagnosis)}"
    noise_rms = size_with_unit(noise_T, "T")
    if rms_T <= noise_T:
        return f"{rms}, not at random, though noise of {noise_rms} would be as large{_mostly(diagnosis)}"
    noise = "readings that were repeated scatter by" if before.noise_from == "repeats" else "noise is"
    return f"{rms} where {noise} {noise_rms}{_mostly(diagnosis)}"


def _mostly(diagnosis: Diagnosis) -> str:
    """The one component of a sensor in which most is wrong; empty where there is none."""
    fit, noise_T = diagnosis.fits.plain, diagnosis.fits.before.lack_of_fit.noise_T
    residual_T = (fit.observations.field_sensor_T - predicted_T(fit)).nan_to_num()
    excess = {
        f"{axis} of {sensor.name}": float(of_axis.square().sum()) - noise_T**2 * int((of_axis != 0.0).sum())
        for i, sensor in enumerate(diagnosis.rig.sensors)
        for axis, of_axis in zip(COMPONENTS, residual_T[fit.observations.sensor == i].T, strict=True)
    }
    most = max(excess, key=excess.__getitem__)
    total = sum(max(each, 0.0) for each in excess.values())
    return f", mostly in {most}" if excess[most] > MOSTLY * total > 0.0 else ""


def gained(diagnosis: Diagnosis) -> str:
    """What the extension gains on unseen readings."""
    improvement = diagnosis.improvement
    if improvement is None or not diagnosis.fits.extended.rig.acting:
        return ""
    before, after = (scores.errors.vector_T for scores in (improvement.before, improvement.after))
    unseen = f"On {len(improvement.before.log_density)} readings that no fit has seen the rms error"
    sizes = f"{size_with_unit(before, 'T', 3)} before, {size_with_unit(after, 'T', 3)} after"
    beside = _beside_the_field(diagnosis)
    if not improvement.is_significant:
        return f"{unseen} does not fall clearly: {sizes}.{beside}"
    if after >= before:  # causes that scatter predict no reading better
        gain = improvement.elpd_difference
        return f"{unseen} does not fall ({sizes}), but how far they miss is told better: log predictive density {gain:+.0f}.{beside}"
    return f"{unseen} falls from {size_with_unit(before, 'T', 3)} to {size_with_unit(after, 'T', 3)}.{beside}"


def _beside_the_field(diagnosis: Diagnosis) -> str:
    """Causes that act in readings of this session and not in the field that the extended rig predicts; empty where there are none."""
    rig = diagnosis.fits.final.rig
    lacking = [diagnosis.label(cause) for cause in rig.acting if not _is_predicted(rig, cause)]
    names = ", ".join(lacking[:MOST_BESIDE]) + (
        f" and {len(lacking) - MOST_BESIDE} more" if len(lacking) > MOST_BESIDE else ""
    )
    return (
        f" That is with {names}, which acts on readings and not on the field that predict gives."
        if names
        else ""
    )


def _is_predicted(rig: Rig, cause: Cause) -> bool:
    """Whether a prediction has all that a cause changes in readings; what scatters, or is a mistake of the record, changes no field."""
    effect = EFFECTS[cause.name]
    if effect.is_record_mistake or isinstance(effect, NoiseEffect):
        return True
    sizes = [quantity for quantity in effect.quantities(Extent()) if not quantity.is_shape]
    return is_in_field(rig, cause) and not any(effect.beyond_the_moment(size.key) for size in sizes)

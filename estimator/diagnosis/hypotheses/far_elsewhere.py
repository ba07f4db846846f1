"""Geometries that the nominal values of a rig refuse, and bodies that sit centimetres from where the rig file puts them.

A wrong frame in the record, or a body elsewhere, may be what puts a sensor into a winding. The search goes in linear steps from the rig as
described, which do not lead out of one; so places are fitted in full, with wide priors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

from estimator.diagnosis import effort, policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.record_mistakes import leaves_much_of_the_field
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.base import Effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import MotionEffect, MountEffect, RecordEffect
from estimator.errors import InvalidInput
from estimator.field.winding_shape import Rule
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.split import spread
from estimator.rig.rig import Cause, Rig

PLACE = ("x_m", "y_m", "z_m")
WIDENED = policy.WIDER_PRIORS[-1]  # of widths of a millimetre and a degree: centimetres are plausible then
SHIFTS_M = (0.02, -0.02, 0.05, -0.05)  # along each axis, at which rules are looked for


def rules_and_refusal(rig: Rig, observations: Observations) -> tuple[Mapping[str, Rule], InvalidInput | None]:
    """Quadrature rules of a rig, and why its geometry is refused, unless no sensor stands inside a winding at nominal values.

    The rules then are those of the first mistake of the record, or other place of a body, that puts the sensors outside, and the fit of the
    record as it is serves for comparison alone.

    Raises:
        InvalidInput: None of these puts the geometry right.
    """
    try:
        return MeasurementModel.build(rig, observations).rules, None
    except InvalidInput as error:
        refusal = error
    for cause, start in _that_move(rig, MeasurementModel.unruled(rig, observations).circumstances):
        moved = with_effect(rig, cause, observations, start)
        try:
            return MeasurementModel.build(moved, observations).rules, refusal
        except InvalidInput:
            continue
    raise refusal


def _that_move(rig: Rig, circumstances: Circumstances) -> Iterator[tuple[Cause, Mapping[str, float]]]:
    """Mistakes of the record that move sensors, then places of bodies, with their starts."""
    for name, effect in EFFECTS.items():
        if effect.is_record_mistake and isinstance(effect, (MotionEffect, RecordEffect)):
            for place in effect.places(rig):
                for start in effect.starts(circumstances, place):
                    yield Cause(name, place), start
    for cause in _places(rig, circumstances):
        for shift_m, key in product(SHIFTS_M, PLACE):
            yield cause, {key: shift_m}


def refit_outside(base: Fit, refusal: InvalidInput) -> Fit:
    """The fit with rules of its own geometry, where its effects put the sensors outside the windings.

    Raises:
        InvalidInput: They do not; the refusal as it was.
    """
    if not base.rig.effects:
        raise refusal
    fitted = base.rig.with_values({p.name: float(base.values[p.name]) for p in base.rig.free})
    try:
        rules = MeasurementModel.build(fitted, base.observations).rules
    except InvalidInput:
        raise refusal from None
    return fit_rig(base.rig, base.observations, base.values, rules)


def far_elsewhere(plain: Fit, refusal: InvalidInput | None) -> list[Fit]:
    """Fits in which one body sits elsewhere, by centimetres where the readings say so, the most probable first.

    None where the place of a body explains no more than a cause of the usual size would, or leaves much of the field.

    Args:
        plain: The rig as described.
        refusal: Why its geometry is refused; None where it is not.
    """
    few, rules = spread(plain.observations, effort.MOST_READINGS_COMPARED), plain.posterior.model.rules
    trials = []
    for cause in _places(plain.rig, plain.circumstances):
        rig = with_effect(plain.rig, cause, plain.observations, {}, factor=WIDENED)
        trials.append(fit_rig(rig, few, plain.values, rules, effort.MORE_STARTS, effort.ROUGH_TOLERANCE))
    trials.sort(key=lambda fit: -fit.log_evidence)
    fits = []
    for trial in trials[: effort.MOST_MISTAKES_FITTED]:
        fit = fit_rig(trial.rig, plain.observations, trial.values, rules)
        try:
            fits.append(fit if refusal is None else refit_outside(fit, refusal))
        except InvalidInput:
            continue
    fits.sort(key=lambda fit: -fit.log_evidence)
    least = plain.log_evidence + policy.LEAST_LOG_EVIDENCE_OF_MISTAKE
    return fits if fits and fits[0].log_evidence > least and not leaves_much_of_the_field(fits[0]) else []


def _places(rig: Rig, circumstances: Circumstances) -> list[Cause]:
    """Other places of single bodies, the same in all readings."""
    return [
        cause
        for name, effect in EFFECTS.items()
        if _is_a_place(effect, circumstances)
        for place in effect.places(rig)
        if (cause := Cause(name, place)) not in rig.effects and effect.concerns(circumstances, place)
    ]


def _is_a_place(effect: Effect, circumstances: Circumstances) -> bool:
    if not isinstance(effect, (MotionEffect, MountEffect)) or effect.is_correction or effect.depends_on:
        return False
    quantities = effect.quantities(circumstances.extent)
    return {*PLACE} <= {quantity.key for quantity in quantities} and not any(q.is_shape for q in quantities)

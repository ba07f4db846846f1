"""Are readings in the units they claim? Refuses what no cause of the library could be, and warns of the rest.

A wrong unit changes all readings alike; a few wild ones, a wrong pose, another frame or a reversed sign do not. So sizes are compared by
their median over readings in the stronger half of the field, and a pattern that disagrees is a warning: a diagnosis may explain it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import MotionEffect
from estimator.errors import InvalidInput, listed
from estimator.model.measurement_model import MeasurementModel
from estimator.model.unlikely_motion import look_like, scaled, unlikely_motion
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.tensors import Tensor, torch

MOST_READINGS, MOST_IN_OTHER_AXES = 300, 40  # that are compared, and in each of many frames
PLAUSIBLE_RATIO = 20.0
USUAL_RATIO = 3.0  # beyond, a scale is told though the pattern is right: gauss under millitesla is ten
CERTAIN_RATIO = 300.0  # no cause of the library makes all fields so much larger, whatever their pattern
SHARE_OF_ALL = 0.8  # of the readings that must miss by such a ratio before it counts as that of all
SAME_PATTERN = 0.7  # correlation above which two patterns are one but for a scale
GOOD_PATTERN = 0.9  # correlation above which nothing is said
FAR = 10.0  # times the median misfit from which a reading counts as wild
MOST_FAR = 0.1  # share of the readings that may be wild; where more are, the pattern is another one
NEARLY_ALONG = 0.8  # cosine between measured and predicted field
LEAST_OF_A_SIGN = 0.1  # share of the readings from which a sign is no slip of single rows
IDLE_SHARE = 0.01  # of a coil's largest current; a meter never shows exactly none
LARGEST_TURN_RAD = 2 * np.pi  # of a rotation vector or a joint in radians
FIELD_FACTORS = (1e3, 1e4, 1e6)  # between units of a field


@dataclass(frozen=True)
class Agreement:
    """How measured fields compare with the rig's nominal model.

    Attributes:
        ratio: Median of measured over predicted size.
        share_beyond: Share of readings whose own ratio is implausible to the same side.
        correlation: Of the patterns, without the readings that are far off.
        far: Numbers of the readings that are far off; empty where there are many.
        along, against: Shares of the readings whose field points nearly along, and nearly against, the predicted one.
    """

    ratio: float
    share_beyond: float
    correlation: float
    far: tuple[int, ...]
    along: float = 1.0
    against: float = 0.0

    @property
    def is_of_both_signs(self) -> bool:
        """Whether fields agree but for a sign that changes from reading to reading."""
        return min(self.along, self.against) > LEAST_OF_A_SIGN and self.along + self.against > SHARE_OF_ALL

    @property
    def is_plausible(self) -> bool:
        """Whether the sizes agree, or only some readings miss."""
        return 1.0 / PLAUSIBLE_RATIO < self.ratio < PLAUSIBLE_RATIO or self.share_beyond < SHARE_OF_ALL

    @property
    def is_usual(self) -> bool:
        """Whether there is nothing to tell."""
        is_of_size = 1.0 / USUAL_RATIO < self.ratio < USUAL_RATIO
        return is_of_size and self.correlation > GOOD_PATTERN and not self.far

    @property
    def is_certain(self) -> bool:
        """Whether a wrong scale is the only explanation of sizes that disagree."""
        is_extreme = not 1.0 / CERTAIN_RATIO < self.ratio < CERTAIN_RATIO
        return is_extreme or abs(self.correlation) > SAME_PATTERN


def check_units(rig: Rig, observations: Observations, where: str) -> list[str]:
    """Refuse readings whose size only fits the rig's nominal model in another unit, and name the likely one.

    Args:
        rig: Its nominal values are what readings are compared with.
        observations: Readings; at most `MOST_READINGS` of them are compared.
        where: File or session that messages name.
    Returns: Sentences on what does not fit and may have a cause, and on positions that are unlikely.
    Raises:
        InvalidInput: Fields, currents, positions or angles of all readings are in another unit.
    """
    told = unlikely_motion(rig, observations, where)
    chosen = torch.arange(len(observations))
    if len(observations) > MOST_READINGS:
        index = np.random.default_rng(0).choice(len(observations), MOST_READINGS, replace=False)
        chosen = torch.from_numpy(np.sort(index))
        observations = observations.rows(chosen)
    given, why = None, "no reading shows a field of a winding"
    try:
        given = _agreement(rig, observations)
    except InvalidInput as refusal:
        why = (
            f"{refusal}; until then coilcal calibrate refuses them, and coilcal diagnose looks for the cause"
        )
    if given is not None and given.is_usual:
        return told
    is_wrong_size = given is not None and not given.is_plausible
    _refuse_motion(rig, observations, is_wrong_size, where)
    if given is None:
        return [*told, f"Units could not be compared with the rig's nominal model: {why} ({where})."]
    if is_wrong_size and given.is_certain:
        mistake = _mistake_of_a_mover(rig, observations)
        if mistake is not None:
            return [
                *told,
                f"Fields are {given.ratio:.3g} times those of the rig's nominal model, and agree with it if {EFFECTS[mistake.name].words} "
                f"({mistake.label}); coilcal diagnose looks for the cause ({where}).",
            ]
        raise InvalidInput(
            f"measured and nominal field must agree to a factor of {PLAUSIBLE_RATIO:g}; their ratio is {given.ratio:.3g}: "
            f"{_likely(given.ratio)} ({where})"
        )
    return [*told, *_warnings(given, observations, chosen, where)]


def _mistake_of_a_mover(rig: Rig, observations: Observations) -> Cause | None:
    """A mistake in the columns of a mover beside which sizes and pattern are as usual, such as another frame; None where none is."""
    few = observations.rows(torch.arange(0, len(observations), 1 + len(observations) // MOST_IN_OTHER_AXES))
    circumstances, by_correlation = Circumstances(rig, few), dict[float, Cause]()
    for effect in EFFECTS.values():
        if not (effect.is_record_mistake and isinstance(effect, MotionEffect)):
            continue
        causes = [Cause(effect.name, place) for place in effect.places(rig)]
        for cause in (cause for cause in causes if effect.concerns(circumstances, cause.place)):
            for start in effect.starts(circumstances, cause.place):
                with suppress(InvalidInput):
                    agreement = _agreement(with_effect(rig, cause, few, start, is_free=False), few)
                    if agreement is not None and agreement.is_usual:
                        by_correlation[agreement.correlation] = cause
    return by_correlation[max(by_correlation)] if by_correlation else None


def _refuse_motion(rig: Rig, observations: Observations, is_wrong_size: bool, where: str) -> None:
    """Refuse positions or rotations that only fit in another unit: such positions move everything out of the field."""
    turned = [
        motion if mover.table is not None else motion[:, 3:].norm(dim=1, keepdim=True)
        for mover in rig.movers
        for motion in (observations.motion[mover.name],)
    ]
    is_turned_beyond = any(bool((turn.abs() > LARGEST_TURN_RAD).double().mean() > 0.1) for turn in turned)
    for kind, factor, is_possible in (
        ("positions", 1e3, is_wrong_size),
        ("positions", 1e2, is_wrong_size),
        ("rotations", 180.0 / np.pi, is_turned_beyond),
    ):
        agreement = None
        if is_possible:
            with suppress(InvalidInput):
                agreement = _agreement(rig, scaled(rig, observations, kind, 1.0 / factor))
        if (
            agreement is not None
            and 1.0 / 3.0 < agreement.ratio < 3.0
            and agreement.correlation > SAME_PATTERN
        ):
            units = look_like(
                rig.movers[0].columns[0 if kind == "positions" else -1],
                factor,
                f": divided by {factor:.4g} they fit the rig's nominal model",
            )
            raise InvalidInput(
                f"{kind} of the movers must be in the unit that is stated; they look like {units} ({where})"
            )


def _likely(ratio: float) -> str:
    factor = min(FIELD_FACTORS, key=lambda factor: abs(np.log(ratio / factor)))
    if 1.0 / 3.0 < ratio / factor < 3.0:
        return f"fields look like {look_like('Bx_T', factor, f' (or currents are too small by {factor:g})')}"
    if 1.0 / 3.0 < ratio * 1e3 < 3.0:
        return f"currents look like {look_like('COIL_current_A', 1e3, ' (or fields are too small by 1000)')}"
    return "check units, currents and the nominal pose"


def _warnings(
    given: Agreement, compared: Observations, chosen: Int[Tensor, " reading"], where: str
) -> list[str]:
    told = []
    if given.far:
        numbers, unit = (chosen + 1, "Reading") if compared.line is None else (compared.line, "Line")
        far = [str(int(numbers[reading])) for reading in given.far]
        units = unit if len(far) == 1 else f"{unit}s"
        told.append(
            f"{units} {listed(far[:3], len(far))}: much farther from the rig's nominal model than the others ({where})."
        )
    if not given.is_plausible:
        told.append(
            f"Fields are {given.ratio:.3g} times those of the rig's nominal model, in another pattern ({where})."
        )
    elif given.is_of_both_signs:
        unsigned = "" if bool((compared.current_A < 0.0).any()) else ", and no current is negative"
        are_together = bool(((compared.current_A != 0.0).sum(dim=1) > 1).any())
        or_a_coil = ", or one of the coils may be connected the other way round" if are_together else ""
        told.append(
            f"Fields point against the rig's nominal model in {100.0 * given.against:.0f} % of the readings and along it in the others"
            f"{unsigned}: currents may be recorded without their sign{or_a_coil}; give them their signs in the file ({where})."
        )
    elif given.correlation < -SAME_PATTERN:
        told.append(
            f"Fields point against the rig's nominal model: a current or an axis may be reversed ({where})."
        )
    elif given.correlation < GOOD_PATTERN:
        told.append(
            f"{'The other fields' if given.far else 'Fields'} correlate with the rig's nominal model by {given.correlation:.2f} only: a "
            f"place, a size, a frame or a sign may be wrong; coilcal diagnose looks for the cause ({where})."
        )
    elif not 1.0 / USUAL_RATIO < given.ratio < USUAL_RATIO:
        told.append(
            f"Fields are {given.ratio:.3g} times those of the rig's nominal model: the unit of fields or of currents, the number of turns, "
            f"or a distance, may be wrong ({where})."
        )
    return told


def _agreement(rig: Rig, observations: Observations) -> Agreement | None:
    """Measured beside nominal field; None where nothing can be compared.

    Raises:
        InvalidInput: A sensor would stand in a winding.
    """
    model = MeasurementModel.build(rig, observations, tolerance=1e-3)
    has_current = observations.current_A != 0.0
    is_wound = torch.tensor([coil.is_wound for coil in rig.coils])
    # Nothing is known beforehand of the field of a coil without a winding.
    powered = has_current.any(dim=1) & ~(has_current & ~is_wound).any(dim=1)
    mask = observations.is_measured & powered[:, None]
    predicted_T = model.predict(model.nominal).masked_fill(~mask, 0.0)
    measured_T = _without_idle_T(observations).masked_fill(~mask, 0.0)
    is_compared = (predicted_T.norm(dim=1) > 0.0) & (measured_T.norm(dim=1) > 0.0)
    if not bool(is_compared.any()):
        return None
    return _compared(predicted_T, measured_T, is_compared)


def _without_idle_T(observations: Observations) -> Float[Tensor, "reading 3"]:
    """Fields less what their sensor shows without current: the room's field may be larger than that of a coil."""
    field_T, current_A = observations.field_sensor_T.clone(), observations.current_A.abs()
    is_idle = (current_A <= IDLE_SHARE * current_A.amax(dim=0)).all(dim=1)
    for sensor in observations.sensor[is_idle].unique():
        is_own = observations.sensor == sensor
        field_T[is_own] -= field_T[is_own & is_idle].nanmedian(dim=0).values.nan_to_num()
    return field_T


def _compared(
    predicted_T: Float[Tensor, "reading 3"],
    measured_T: Float[Tensor, "reading 3"],
    is_compared: Bool[Tensor, " reading"],
) -> Agreement:
    readings = is_compared.nonzero().flatten()
    predicted_T, measured_T = predicted_T[readings], measured_T[readings]
    size_T = predicted_T.norm(dim=1)
    is_strong = size_T >= size_T.median()
    ratios = (measured_T.norm(dim=1) / size_T)[is_strong]
    ratio = float(ratios.median())
    beyond = ratios > PLAUSIBLE_RATIO if ratio > 1.0 else ratios < 1.0 / PLAUSIBLE_RATIO
    along = float((predicted_T * measured_T).sum(dim=1)[is_strong].sign().sum())
    misfit_T = (measured_T - (ratio if along >= 0.0 else -ratio) * predicted_T).norm(dim=1)
    # Coordinates that are wrong may predict much where little is measured: what is compared is the misfit itself. Beside a winding
    # fields are large and steep, and a place that is a little wrong leaves more, but the same share.
    own_T = torch.minimum(ratio * size_T, measured_T.norm(dim=1))
    share = (misfit_T / (ratio * size_T))[is_strong].median()
    is_far = misfit_T > FAR * torch.maximum(misfit_T.median(), 0.05 * ratio * size_T.median())
    is_far &= misfit_T > FAR * share * own_T
    if float(is_far.double().mean()) > MOST_FAR:
        is_far = torch.zeros_like(is_far)
    nominal_T, shown_T = predicted_T[~is_far].flatten(), measured_T[~is_far].flatten()
    correlation = float((nominal_T * shown_T).sum() / (nominal_T.norm() * shown_T.norm()))
    far = tuple(readings[is_far].tolist())
    cosine = ((predicted_T * measured_T).sum(dim=1) / (size_T * measured_T.norm(dim=1)))[is_strong]
    along, against = ((sign * cosine > NEARLY_ALONG).double().mean() for sign in (1.0, -1.0))
    return Agreement(ratio, float(beyond.double().mean()), correlation, far, float(along), float(against))

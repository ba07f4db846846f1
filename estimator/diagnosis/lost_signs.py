"""Currents that were recorded without their sign: the field tells in which readings they flowed the other way.

Half of the rows may be wrong then, so no fit to the majority finds them. Signs, the gain of each coil and a constant field at each
sensor are fitted in turn to the nominal field of each coil, as in clustering by k-means.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.expectation import predict_T
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.row_odds import follow_a_column, n_runs
from estimator.errors import InvalidInput
from estimator.least_squares import least_squares
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.flags import Flag, Reason, in_time, without_flagged
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

MOST_COILS = 6  # without signs, all combinations of which are tried in each reading
MOST_TURNS = 20  # of choosing signs and fitting
OF_NOMINAL, OF_FITTED = 0.05, 0.01  # shares of its field that a rig as described, or fitted, may well be off
LEAST_LOG_ODDS = policy.NEAR_TO_EXPECTED**2 / 2.0  # of a sign, from which a reading tells if signs were lost
MEDIAN_OF_THREE = 1.538  # of the length of three normal errors
LEAST_SIZE = 1e-3  # of such an error, over the largest one
FEWEST_RUNS = 3  # fewer stretches with the other sign are causes of the library: `current_sign_since`, `current_sign_spell`


class _Signed(NamedTuple):
    """Signs that fit best.

    Attributes:
        signs: Of each current, 1 as recorded.
        log_odds: Of each of them against the other sign, at normal errors.
        size_T: Size of the error that each reading may well have.
        off_T: Error of each reading.
        of_coil_T: Field of each coil, as fitted, with the recorded current.
    """

    signs: Float[Tensor, "reading coil"]
    log_odds: Float[Tensor, "reading coil"]
    size_T: Float[Tensor, " reading"]
    off_T: Float[Tensor, " reading"]
    of_coil_T: Float[Tensor, "reading coil 3"]


class LostSigns(NamedTuple):
    """Readings of coils whose currents were recorded without their sign.

    Attributes:
        flags: Those during which a current flowed the other way.
        undecided: Numbers of those in which the rig is not known well enough to say which way one flowed.
    """

    flags: list[Flag]
    undecided: set[int]

    def without(self, observations: Observations) -> Observations:
        """The readings as if neither had been measured."""
        field_T = without_flagged(observations, self.flags).field_sensor_T.clone()
        field_T[list(self.undecided)] = torch.nan
        return observations.with_field(field_T)


def lost_signs(rig: Rig, observations: Observations, fit: Fit | None = None) -> LostSigns:
    """Readings during which the current of a coil flowed the other way, where the record has one sign of it only.

    None where both signs were recorded, where the others do not agree with the field of the rig up to signs, or where a place or a
    stretch of time tells as well which readings they are.

    Args:
        rig: Its nominal values are what readings are compared with, where there is no fit.
        observations: A whole session.
        fit: Of the rig to the readings whose signs are known.
    """
    current_A = observations.current_A
    lacking = [
        i
        for i, coil in enumerate(rig.coils)
        if coil.is_wound and bool((current_A[:, i] != 0.0).any()) and _has_one_sign(current_A[:, i])
    ]
    result = LostSigns([], set())
    if not 0 < len(lacking) <= MOST_COILS or not bool(observations.is_measured.any()):
        return result
    try:
        expected_T = _expected_T(rig, observations, fit)
    except InvalidInput:
        return result  # a sensor stands in a winding there
    if not bool(expected_T[1].any()):
        return result
    off_by = OF_NOMINAL if fit is None else OF_FITTED
    best = min(
        (_signed(observations, *expected_T, lacking, off_by, at_mean) for at_mean in (False, True)),
        key=lambda signed: float((signed.off_T / signed.size_T).median()),
    )
    field_T = best.of_coil_T.norm(dim=2).sum(dim=1)
    agrees_at_all = best.off_T < (policy.FIELD_BUT_FOR_ITS_SIGN * field_T).maximum(
        _noise_T(observations, best)
    )
    for i in lacking:
        is_clear, is_reversed = best.log_odds[:, i] > LEAST_LOG_ODDS, best.signs[:, i] < 0.0
        agrees = is_clear & agrees_at_all
        n_clear, n_reversed = int(is_clear.sum()), int((is_reversed & is_clear).sum())
        least = policy.LEAST_OF_A_SIGN * n_clear
        if not least < n_reversed < n_clear - least or int(agrees.sum()) < n_clear - least:
            continue
        if not _is_at_random(observations, is_clear, is_reversed):
            continue
        is_likely = best.log_odds[:, i] > math.log(policy.MUCH_MORE_PROBABLE)
        result.undecided.update((~is_likely & (current_A[:, i] != 0.0)).nonzero().flatten().tolist())
        words = f"was read while the current of {rig.coils[i].name} flowed the other way, for its sign is not recorded"
        is_told = is_reversed & is_likely
        for sensor in observations.sensor[is_told].unique().tolist():
            readings = (is_told & (observations.sensor == sensor)).nonzero().flatten().tolist()
            result.flags.append(Flag.of(observations, Reason.OTHERWISE, words, None, readings))
    return result


def _noise_T(observations: Observations, signed: _Signed) -> Float[Tensor, " reading"]:
    """Size up to which an error is noise: twice the median where fields are weak, for those of a wrong model grow with the field."""
    field_T = signed.of_coil_T.norm(dim=2).sum(dim=1)
    has_field = field_T > 0.0
    is_weak = has_field & (field_T <= field_T[has_field].median())
    return 2.0 * _median_of_sensor(signed.off_T, observations, is_weak)


def _median_of_sensor(
    off_T: Float[Tensor, " reading"], observations: Observations, is_chosen: Bool[Tensor, " reading"]
) -> Float[Tensor, " reading"]:
    """Median error over some readings of the sensor that each belongs to; 0 where it has none of them."""
    median_T = torch.zeros_like(off_T)
    for sensor in observations.sensor[is_chosen].unique():
        is_own = observations.sensor == sensor
        median_T[is_own] = off_T[is_own & is_chosen].median()
    return median_T


def _is_at_random(
    observations: Observations, is_clear: Bool[Tensor, " reading"], is_reversed: Bool[Tensor, " reading"]
) -> bool:
    """Whether neither a few stretches of time nor a setting tell which of the clear readings are reversed."""
    settings = torch.cat((observations.current_A, *observations.motion.values()), dim=1)
    for sensor in observations.sensor.unique().tolist():
        own = in_time(observations, sensor)
        own = own[is_clear[own]]
        if n_runs(is_reversed[own]) >= FEWEST_RUNS and not follow_a_column(settings[own], is_reversed[own]):
            return True
    return False


def _has_one_sign(current_A: Float[Tensor, " reading"]) -> bool:
    return not bool((current_A > 0.0).any() and (current_A < 0.0).any())


def _expected_T(
    rig: Rig, observations: Observations, fit: Fit | None
) -> tuple[Float[Tensor, "reading 3"], Float[Tensor, "reading coil 3"]]:
    """What is expected without currents, and the part of each coil.

    Raises:
        InvalidInput: A sensor stands in a winding at nominal values.
    """
    rules = None if fit else MeasurementModel.build(rig, observations, tolerance=1e-3).rules

    def predicted_T(current_A: Tensor) -> Float[Tensor, "reading 3"]:
        readings = replace(observations, current_A=current_A)
        if fit is not None:
            return predict_T(fit, fit.values, readings)
        model = MeasurementModel.unruled(rig, readings).with_rules(rules or {})
        return model.predict(model.nominal).expand(len(readings), 3)

    current_A = observations.current_A
    still_T = predicted_T(torch.zeros_like(current_A))
    alone = torch.eye(current_A.shape[1], dtype=current_A.dtype, device=current_A.device)
    return still_T, torch.stack([predicted_T(current_A * of_coil) - still_T for of_coil in alone], dim=1)


def _signed(
    observations: Observations,
    still_T: Float[Tensor, "reading 3"],
    of_coil_T: Float[Tensor, "reading coil 3"],
    lacking: list[int],
    off_by: float,
    starts_at_mean: bool,
) -> _Signed:
    """Signs, gains and constant fields in turn, from no constant field or from the mean, about which fields of both signs lie."""
    is_measured = observations.is_measured
    measured_T = (observations.field_sensor_T - still_T).masked_fill(~is_measured, 0.0)
    of_coil_T = of_coil_T.masked_fill(~is_measured[:, None], 0.0)
    of_sensor = torch.nn.functional.one_hot(observations.sensor).to(measured_T)
    n, n_coils, n_sensors = *of_coil_T.shape[:2], of_sensor.shape[1]
    constant = torch.einsum("ns,ij->nisj", of_sensor, torch.eye(3).to(measured_T)).reshape(
        n, 3, 3 * n_sensors
    )
    constant = constant * is_measured[:, :, None]
    choices = of_coil_T.new_ones(2 ** len(lacking), n_coils)
    choices[:, lacking] = of_coil_T.new_tensor(list(product((1.0, -1.0), repeat=len(lacking))))
    gain, room_T = of_coil_T.new_ones(n_coils), of_coil_T.new_zeros(3 * n_sensors)
    if starts_at_mean:
        room_T = ((of_sensor.T @ measured_T) / (of_sensor.T @ is_measured.double()).clamp(min=1.0)).flatten()
    largest_T = of_coil_T.norm(dim=2).sum(dim=1)
    signs = choices[:1].expand(n, -1)
    for _ in range(MOST_TURNS):
        rest_T = measured_T - constant @ room_T
        by_choice_T = torch.einsum("kc,ncj->nkj", choices * gain, of_coil_T)
        each_off_T = (rest_T[:, None] - by_choice_T).norm(dim=2)
        off_T, chosen = each_off_T.min(dim=1)
        before, signs = signs, choices[chosen]
        size_T = off_by * largest_T + _median_of_sensor(off_T, observations, is_measured.any(dim=1))
        size_T = size_T.clamp(min=LEAST_SIZE * float(size_T.max()))
        design = torch.cat(((signs[:, :, None] * of_coil_T).mT, constant), dim=2) / size_T[:, None, None]
        design = design.flatten(0, 1)
        solution = least_squares(design.T @ design, design.T @ (measured_T / size_T[:, None]).flatten())
        gain, room_T = solution[:n_coils], solution[n_coils:]
        if bool((signs == before).all()):
            break
    squares = (MEDIAN_OF_THREE * each_off_T / size_T[:, None]).square()
    log_odds = torch.zeros_like(signs)
    for i in lacking:
        either = [squares[:, choices[:, i] == sign].amin(dim=1) for sign in (1.0, -1.0)]
        log_odds[:, i] = 0.5 * (either[0] - either[1]).abs()
    return _Signed(signs, log_odds, size_T, off_T, gain[:, None] * of_coil_T)

"""What residuals of a fit depend on: halves of a session, unseen readings, and the patterns of causes that the rig does not have.

A fit follows what it can, so a wrong model may leave little. Fits to two halves then find different numbers, which the Chow test sees
without knowing the noise: it asks whether derivatives of the prediction that are switched on in one half explain the residuals.

A fit follows most of what a weak cause does and leaves little of it, which a global misfit does not show. Along the changes that this
cause would make it stands out. Which cause it is, among those that look alike, is asked by a diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.special import fdtrc
from torch import Tensor

from estimator.calibration.linear_fit import Disagreement, LinearFit
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import MountEffect
from estimator.model.cause_columns import cause_columns, causes_beside
from estimator.rig.rig import Cause
from estimator.side_by_side import each, one_thread_for_an_operation

MOST_COLUMNS = 300  # of derivatives; coils without a winding have more, and are asked by their response alone
LEAST_IN_HALF = 0.1  # of the readings


def disagreements(fit: LinearFit) -> list[Disagreement]:
    """What the residuals of a fit depend on, the most striking first; p-values count all tests.

    References: Chow, Econometrica 28 (1960) 591 (equality of coefficients in two halves).
    """
    p_values = {words: float(fit.p_values(columns[None])[0]) for words, columns in _tests(fit)}
    adjusted = [Disagreement(words, min(1.0, len(p_values) * p_value)) for words, p_value in p_values.items()]
    return sorted(adjusted, key=lambda each: each.p_value)


def unseen(fit: LinearFit, beyond: LinearFit) -> Disagreement:
    """Whether readings that took no part in a fit are missed by more than noise and the fit's own uncertainty.

    Args:
        fit: To the readings that it has seen.
        beyond: The same model and values at the readings that it has not seen.
    References: Chow, Econometrica 28 (1960) 591 (equality of coefficients where the second set is small).
    """
    n, n_seen = len(beyond.sigma_T), len(fit.sigma_T)
    precision = fit.jacobian.mT @ fit.jacobian
    step = torch.linalg.solve(precision, fit.jacobian.mT @ fit.residual)  # nothing at the best values
    jacobian, residual = beyond.jacobian[:n], beyond.residual[:n] - beyond.jacobian[:n] @ step
    followed = jacobian.mT @ residual
    square = residual.square().sum() - followed @ torch.linalg.solve(
        precision + jacobian.mT @ jacobian, followed
    )
    ratio = float(square / n / (fit.left_square / n_seen))
    words = "unseen readings are missed by more than the noise and the intervals of the fit"
    return Disagreement(words, float(fdtrc(n, n_seen, ratio)))


def _tests(fit: LinearFit) -> Iterator[tuple[str, Tensor]]:
    """Each test with the changes of the readings that it asks for."""
    rig, observations = fit.posterior.model.rig, fit.posterior.model.circumstances.observations
    for i, sensor in enumerate(rig.sensors):
        is_of_sensor = (observations.sensor == i).to(torch.float64)[:, None]
        shown = fit.predicted_T * is_of_sensor
        columns = [_on_axis(is_of_sensor[:, 0], axis) for axis in range(3)]
        columns += [_on_axis(shown[:, other], axis) for axis in range(3) for other in range(3)]
        words = (
            f"what {sensor.name} shows is turned, stretched or shifted beside the field that the fit predicts"
        )
        yield words, fit.rows(torch.stack(columns))
    words = "readings have a share of the field that the same sensor read before"
    yield words, fit.rows(torch.stack(_fields_before(fit)))
    if fit.jacobian.shape[1] > MOST_COLUMNS:
        return
    for words, is_in in _halves(fit.posterior.model.circumstances):
        share = float(is_in.to(torch.float64).mean())
        if LEAST_IN_HALF <= share <= 1.0 - LEAST_IN_HALF:
            constant = torch.stack([_on_axis(is_in.to(torch.float64), axis) for axis in range(3)])
            yield words, torch.cat((fit.derivatives(is_in), fit.rows(constant)), dim=1)


def _fields_before(fit: LinearFit) -> list[Tensor]:
    """For each sensor, at its readings, the field that the fit predicts for the one before; nothing at those of others."""
    rig, observations = fit.posterior.model.rig, fit.posterior.model.circumstances.observations
    columns = []
    for i in range(len(rig.sensors)):
        rows = torch.nonzero(observations.sensor == i)[:, 0]
        rows = rows[torch.argsort(observations.time_s[rows], stable=True)]
        before = torch.zeros_like(fit.predicted_T)
        before[rows[1:]] = fit.predicted_T[rows[:-1]]
        columns.append(before)
    return columns


def _halves(circumstances: Circumstances) -> Iterator[tuple[str, Bool[Tensor, " reading"]]]:
    """Halves of the readings, and what is said where fits to the two disagree."""
    rig, observations = circumstances.rig, circumstances.observations
    current_A = observations.current_A
    yield "readings without current disagree with the others", (current_A == 0.0).all(dim=1)
    for i, coil in enumerate(rig.coils):
        of_coil = current_A[:, i]
        yield f"readings with a negative current in {coil.name} disagree with the others", of_coil < 0.0
        powered = of_coil[of_coil != 0.0].abs()
        if len(powered):
            middle = 0.5 * (powered.min() + powered.max())
            words = f"readings with more than {float(middle):.3g} A in {coil.name} disagree with the others"
            yield words, of_coil.abs() > middle
    yield "the first half of the session disagrees with the second", _above_median(-observations.time_s)
    for mover in rig.movers:
        columns = observations.motion[mover.name]
        for name, column in zip(mover.columns, columns.unbind(1), strict=True):
            if float(column.max() - column.min()) > 0.0:
                yield (
                    f"readings with a large {name} disagree with those with a small one",
                    _above_median(column),
                )
        for axis, side in zip("xyz", circumstances.approach(mover.name).unbind(1), strict=True):
            yield (
                f"readings that {mover.name} reached upwards along its {axis} axis disagree with the others",
                side > 0.0,
            )
    if len(rig.sensors) > 1:
        for i, sensor in enumerate(rig.sensors):
            yield f"readings of {sensor.name} disagree with those of the others", observations.sensor == i


def _above_median(values: Float[Tensor, " reading"]) -> Bool[Tensor, " reading"]:
    return values > values.median()


def _on_axis(by_reading: Float[Tensor, " reading"], axis: int) -> Float[Tensor, "reading 3"]:
    columns = by_reading.new_zeros(len(by_reading), 3)
    columns[:, axis] = by_reading
    return columns


NO_CHANGE = 1e-6  # of the noise: what rounding leaves of a cause whose start changes nothing


def clearest_pattern(fit: LinearFit) -> Disagreement | None:
    """The pattern of a cause that noise alone makes least probable, counted over all that were asked; None where none was."""
    model = fit.posterior.model
    asked = list(_groups(fit, causes_beside(model.rig, model.circumstances)))
    with one_thread_for_an_operation():
        at_sensor_T = model.at_sensor_T(fit.values)
        p_values = list(each(lambda group: _p_values(fit, at_sensor_T, *group), asked))
    n_tests = sum(map(len, p_values))
    if not n_tests:
        return None
    smallest = [values.min(initial=1.0) for values in p_values]
    cause = asked[int(np.argmin(smallest))][0]
    words = f"the residuals have the pattern of {cause.name}, or of something like it"
    return Disagreement(words, min(1.0, n_tests * float(min(smallest))))


def _groups(fit: LinearFit, causes: list[Cause]) -> Iterator[tuple[Cause, list[dict[str, float]]]]:
    """Each cause with starts of its shapes that one prediction serves; what ends again is seen by what stays."""
    circumstances = fit.posterior.model.circumstances
    for cause in causes:
        effect = EFFECTS[cause.name]
        if effect.stays is not None:
            continue
        starts = list(effect.starts(circumstances, cause.place))
        is_alike = not isinstance(effect, MountEffect)  # whose columns depend on the start
        for together in filter(None, [starts] if is_alike else [[shapes] for shapes in starts]):
            yield cause, together


def _p_values(
    fit: LinearFit, at_sensor_T: torch.Tensor, cause: Cause, starts: list[dict[str, float]]
) -> np.ndarray:
    """For each start; none where the cause has no finite change."""
    made = cause_columns(fit.posterior.model, fit.values, cause, starts, at_sensor_T)
    shift_T = made.started_T - fit.predicted_T
    is_rounding = shift_T.abs().amax(dim=(1, 2), keepdim=True) < NO_CHANGE * fit.sigma_T.min()
    changes_T = torch.cat((made.slope_T, torch.where(is_rounding, 0.0, shift_T)[:, None]), dim=1)
    changes_T = changes_T[torch.isfinite(changes_T).all(dim=(1, 2, 3))]
    return fit.p_values(fit.rows(changes_T)) if len(changes_T) else np.empty(0)

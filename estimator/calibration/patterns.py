"""Whether residuals have the pattern of a cause that the rig does not have: iron beside it, a turned axis, a drift.

A fit follows most of what a weak cause does and leaves little of it, which a global misfit does not show. Along the changes that this
cause would make it stands out. Which cause it is, among those that look alike, is asked by a diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from estimator.calibration.linear_fit import Disagreement, LinearFit
from estimator.effects import EFFECTS
from estimator.effects.stages import MountEffect
from estimator.model.cause_columns import cause_columns, causes_beside
from estimator.rig.rig import Cause
from estimator.side_by_side import each, one_thread_for_an_operation

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

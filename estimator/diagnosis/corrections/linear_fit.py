"""A fit with one more correction in the linear model: predictions to first order about a fit, and in the amplitudes of the correction.

Evaluating it costs algebra with a fixed Jacobian in place of fields at every reading. Noise, outliers and priors are as in a full fit.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.derivatives import value_and_jacobian
from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.inference.likelihood import FirstOrder, LogPosterior
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig


class LinearPosterior(LogPosterior):
    """The log posterior density where predictions are linear in the coordinates.

    Attributes:
        full: The density of the full model.

    Args:
        posterior: That density, whose noise and priors stay.
        about: Coordinates of the point about which predictions are taken.
        predicted_T: Predictions there.
        jacobian_T: Their derivatives there.
    """

    def __init__(
        self,
        posterior: LogPosterior,
        about: Float[Tensor, " coordinate"],
        predicted_T: Float[Tensor, " component"],
        jacobian_T: Float[Tensor, "component coordinate"],
    ) -> None:
        self.__dict__.update(posterior.__dict__)
        self.full = posterior
        self._about, self._predicted_T, self._jacobian_T = about, predicted_T, jacobian_T

    def predicted(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch component"]:
        """Predicted value of every measured component, in tesla, to first order."""
        predicted_T: Tensor = self._predicted_T + (vector - self._about) @ self._jacobian_T.T
        return predicted_T

    def to_first_order(
        self, vector: Float[Tensor, "*batch coordinate"], columns: Int[Tensor, " column"] | None = None
    ) -> FirstOrder:
        """Predictions, noise, and how both change with the coordinates; the Jacobian of the predictions is the same everywhere."""
        log_sigma, log_sigma_jacobian = value_and_jacobian(
            lambda step: torch.log(self.component_sigma_T(vector + step)), torch.zeros_like(self._about)
        )
        jacobian_T = self._jacobian_T.expand_as(log_sigma_jacobian)
        if columns is not None:
            jacobian_T, log_sigma_jacobian = jacobian_T[..., columns], log_sigma_jacobian[..., columns]
        return FirstOrder(self.predicted(vector), torch.exp(log_sigma), jacobian_T, log_sigma_jacobian)


def linear_fit(fit: Fit, rig: Rig, columns_T: dict[str, Float[Tensor, " component"]]) -> Fit:
    """The fit with further parameters in the linear model about it.

    Args:
        fit: A full fit, or one in the linear model.
        rig: That of the fit with further parameters, which at their nominal values change nothing.
        columns_T: Change of the measured components per unit of each further parameter; others change nothing to first order.
    """
    coordinates = Coordinates(rig).on(fit.observations.device)
    model = fit.posterior.model.with_effects_of(rig)
    about = coordinates.vector(fit.start_with(rig))
    own = fit.jacobian / fit.whitening_per_T[:, None]
    by_name = {**dict(zip(fit.posterior.coordinates.names, own.unbind(1), strict=True)), **columns_T}
    nothing = torch.zeros_like(fit.predicted_T)
    jacobian_T = torch.stack([by_name.get(name, nothing) for name in coordinates.names], dim=1)
    posterior = LogPosterior(coordinates, model, fit.observations)
    linear = LinearPosterior(posterior, about, fit.predicted_T, jacobian_T)
    optimum = levenberg_marquardt(linear, about[None], tolerance=policy.ROUGH_TOLERANCE)
    return Fit(linear, optimum)


def density_in_full(fit: Fit) -> float:
    """Log posterior density of the full model at a fit, up to the constant of its rig."""
    posterior = fit.posterior.full if isinstance(fit.posterior, LinearPosterior) else fit.posterior
    with torch.no_grad():
        return float(posterior(fit.vector[None])[0])


def full_fit(linear: Fit, before: Fit, tolerance: float | None = None) -> Fit:
    """The full fit of a rig that was fitted in the linear model, from its values, or from those of the fit before if more probable."""
    is_better = density_in_full(linear) > density_in_full(before)
    start = linear.values if is_better else before.start_with(linear.rig)
    rules = linear.posterior.model.rules
    return fit_rig(linear.rig, linear.observations, start, rules, tolerance=tolerance, near=linear)

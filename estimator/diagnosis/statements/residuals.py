"""Residuals of the rig as described and as extended, around the coils that carried current."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.result import Diagnosis
from estimator.rig.bodies import AnyCoil

MOST_COILS = 2


@dataclass(frozen=True)
class Around:
    """Positions of the sensor as seen from one coil, by the extended rig.

    Attributes:
        coil: The coil.
        is_on: Readings in which it carried current.
        position_m: Of the sensor in the coil's frame, in these readings.
        coil_from_sensor: Rotations of the same readings.
    """

    coil: AnyCoil
    is_on: Bool[Tensor, " reading"]
    position_m: Float[Tensor, "on 3"]
    coil_from_sensor: Float[Tensor, "on 3 3"]


def around_coils(diagnosis: Diagnosis) -> Iterator[Around]:
    """The first coils that carried current."""
    fit = diagnosis.fits.extended
    is_on = fit.observations.current_A != 0.0
    powered = is_on.any(0).nonzero().flatten().tolist()
    for i in powered[:MOST_COILS]:
        coil, rows = fit.rig.coils[i], is_on[:, i]
        position_m, coil_from_sensor = fit.posterior.model.readings_in_coil(coil, fit.values)
        yield Around(coil, rows, position_m[rows], coil_from_sensor[rows])


def is_extended(diagnosis: Diagnosis) -> bool:
    """Whether the extended rig has causes or corrections that the rig as described has not."""
    return diagnosis.fits.extended.rig.acting != diagnosis.fits.plain.rig.acting


def sigma_T(fit: Fit) -> Float[Tensor, "reading 3"]:
    """Noise of each component of each reading, as the fit has it."""
    with torch.no_grad():
        by_sensor_T = fit.posterior.sigma_T(fit.vector)
    return by_sensor_T[fit.observations.sensor][:, None].expand(-1, 3)


def left_sigma(fit: Fit, noise_of: Fit) -> float:
    """Root mean square of the residual of a fit in units of the noise of the same or of another one."""
    with torch.no_grad():
        missed_T = fit.posterior.measured_T - fit.posterior.predicted(fit.vector)
        noise_T = noise_of.posterior.component_sigma_T(noise_of.vector)
    return float((missed_T / noise_T).square().mean().sqrt())

"""The protocol of a calibration that can be exported; `estimator.calibration.result.Calibration` fulfils it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from estimator.model.room_field import RoomField
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.tensors import Tensor

Motion = Mapping[str, Float[Tensor, " 6"]]


@runtime_checkable
class Calibrated(Protocol):
    """A calibrated model with its posterior; attributes and methods as in `Calibration`."""

    @property
    def rig(self) -> Rig:
        """The rig with its priors."""

    @property
    def observations(self) -> Observations:
        """The readings that it was made from."""

    @property
    def best(self) -> Mapping[str, float]:
        """Every number of the rig at the maximum of the posterior."""

    @property
    def draws(self) -> Mapping[str, np.ndarray]:
        """Posterior draws of every free parameter, walker by step."""

    @property
    def log_prob(self) -> np.ndarray:
        """Log posterior density of the draws."""

    @property
    def summary_json(self) -> Mapping[str, Any]:
        """Content of `summary.json`."""

    def best_values(self) -> dict[str, Tensor]:
        """Every number of the rig at the maximum of the posterior, as tensors."""

    def room(self, points_m: Float[Tensor, "point 3"], motion: Motion | None) -> RoomField:
        """The coils with each mover in one pose."""

    def currents(self, currents_A: Mapping[str, float]) -> Float[Tensor, " coil"]:
        """Currents in the order of the rig's coils; those that are not named are off."""

    def field(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        motion: Motion | None = None,
    ) -> Float[Tensor, "point 3"]:
        """Flux density in the world frame, in tesla."""

    def gradient(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Mapping[str, float],
        motion: Motion | None = None,
    ) -> Float[Tensor, "point 3 3"]:
        """dB_i / dx_j in the world frame, in T/m."""

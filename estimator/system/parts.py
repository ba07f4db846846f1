"""Calibrated coils of one room, each once: their currents, and draws of all their posteriors together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from jaxtyping import Float

from estimator.calibration.result import INTERVAL_DRAWS, Calibration
from estimator.errors import InvalidInput, check_known
from estimator.glance import Shown
from estimator.rig.coordinates import Values
from estimator.tensors import Tensor, torch


@dataclass(frozen=True, repr=False)
class CalibratedCoils(Shown):
    """Coils of one room, each with the model of its calibration.

    Attributes:
        calibrations: Calibration of each coil, by its name; their order is that of the currents.
    """

    calibrations: Mapping[str, Calibration]

    def __post_init__(self) -> None:
        if not self.calibrations:
            raise InvalidInput("system must have at least one coil; received none")
        for name, calibration in self.calibrations.items():
            coil_names = [coil.name for coil in calibration.rig.coils]
            if name not in coil_names:
                raise InvalidInput(
                    f"system must name coils of their calibrations; rig {calibration.rig.name!r} has {', '.join(coil_names)}, not {name!r}"
                )

    @property
    def coils(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return tuple(self.calibrations)

    @cached_property
    def parts(self) -> tuple[Calibration, ...]:
        """Each calibration once, without the coils that come from another one."""
        parts: list[Calibration] = []
        has_background = False
        for calibration in {id(c): c for c in self.calibrations.values()}.values():
            coils = tuple(c for c in calibration.rig.coils if self.calibrations.get(c.name) is calibration)
            left_out = {coil.name for coil in calibration.rig.coils} - {coil.name for coil in coils}
            alone = calibration.coils_alone()
            rig = alone.rig if has_background else calibration.rig
            effects, corrections = (
                tuple(cause for cause in acting if cause.place not in left_out)
                for acting in (rig.effects, rig.corrections)
            )
            parts.append(
                replace(calibration, rig=replace(rig, coils=coils, effects=effects, corrections=corrections))
            )
            has_background = has_background or alone.rig.acting != calibration.rig.acting
        return tuple(parts)

    def currents(self, currents_A: Mapping[str, float]) -> Float[Tensor, " coil"]:
        """Currents by name as a vector; coils that are not named are off.

        Raises:
            InvalidInput: A name is not a coil of the system.
        """
        check_known("currents must name coils of the system", currents_A, self.coils)
        return torch.tensor([float(currents_A.get(name, 0.0)) for name in self.coils], dtype=torch.float64)

    def draws(self) -> tuple[Values, ...]:
        """Posterior draws of each part, equally many.

        Calibrations with the same seed share their random numbers, so the draws of each part are shuffled.
        """
        n = min(INTERVAL_DRAWS, *(part.log_prob.size for part in self.parts))
        draws = []
        for i, part in enumerate(self.parts):
            order = torch.randperm(n, generator=torch.Generator().manual_seed(i))
            values = part.draw_values(n)
            draws.append({name: value[order] if value.ndim else value for name, value in values.items()})
        return tuple(draws)

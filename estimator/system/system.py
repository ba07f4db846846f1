"""Several calibrated coils on several arms as one magnet: field, gradient, force, their intervals, and currents for a wanted field.

Each coil's model comes from the calibration that measured it, so arms may be calibrated one coil at a time (paper, eq 14-17, 22). The sum
assumes that no coil drives another; `estimator.system.superposition` tests this on readings with all coils on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from jaxtyping import Float

from estimator.calibration.result import INTERVAL_DRAWS, Calibration
from estimator.errors import InvalidInput, check_known
from estimator.export import formats
from estimator.export.magnet import Magnet
from estimator.export.request import Grid
from estimator.glance import Glance, Shown
from estimator.points import given_points
from estimator.rig.coordinates import Values
from estimator.system.compiled import CompiledSystem
from estimator.system.system_field import SystemField
from estimator.tensors import Tensor, torch

Motion = Mapping[str, Float[Tensor, "... 6"]]


@dataclass(frozen=True, repr=False)
class System(Shown):
    """Coils of one room, each with the model of its calibration.

    All calibrations must give poses in the same world frame, such as that of a shared sensor. A constant field of the room is taken from
    the first calibration that has one.

    Attributes:
        calibrations: Calibration of each coil, by its name; their order is that of the currents.

    Examples:
        >>> from estimator import calibrate, load_session
        >>> system = System.of(calibrate(load_session("arm1.zarr")), calibrate(load_session("arm2.zarr")))  # doctest: +SKIP
        >>> here = system.at(points_m, {"arm1": joints1_rad, "arm2": joints2_rad})  # doctest: +SKIP
        >>> here.field_T({"coil1": 3.0})  # doctest: +SKIP
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

    @classmethod
    def of(cls, *calibrations: Calibration) -> System:
        """The system of all coils that were on, each from the calibration in whose readings it was on.

        Raises:
            InvalidInput: A coil was on in two calibrations; call `System` with the one to use.
        """
        by_coil: dict[str, Calibration] = {}
        for calibration in calibrations:
            was_on = (calibration.observations.current_A != 0.0).any(dim=0).tolist()
            for coil, on in zip(calibration.rig.coils, was_on, strict=True):
                if on and coil.name in by_coil:
                    raise InvalidInput(f"system: {coil.name} must be on in one calibration; received two")
                if on:
                    by_coil[coil.name] = calibration
        return cls(by_coil)

    def glance(self) -> Glance:
        """The coils, and how good the calibration of each is."""
        rows = [
            (name, calibration.rig.name, calibration.summary().get("quality", {}).get("verdict", ""))
            for name, calibration in self.calibrations.items()
        ]
        sentence = f"System of {len(rows)} {'coil' if len(rows) == 1 else 'coils'} in one room."
        return Glance(sentence, ("coil", "calibrated on", "verdict"), rows)

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

    def at(self, points_m: Any, motion: Mapping[str, Any] | None = None) -> SystemField:
        """The system with its movers in given poses; results can be differentiated in points and motion.

        Args:
            points_m: Points in the world frame, as `Calibration.field` takes them; answers of `SystemField` are of their kind, in
                double precision.
            motion: Joint values or displacement of each mover: six numbers, or six per point. A mover that reports displacements defaults
                to zero.
        Raises:
            InvalidInput: An unknown mover, or a mover that carries a coil and has no motion.
        """
        points, motion = given_points(points_m), motion or {}
        movers = sorted({mover.name for part in self.parts for mover in part.rig.movers})
        check_known("motion must name movers of the system", motion, movers)
        rooms = []
        for part in self.parts:
            part_motion = {
                mover.name: motion[mover.name] for mover in part.rig.movers if mover.name in motion
            }
            rooms.append(part.room(points.points_m.double(), part_motion))
        return SystemField(self, tuple(rooms), points)

    def compiled(self) -> CompiledSystem:
        """These coils in machine code, for a point in microseconds; without intervals and derivatives in the pose.

        Raises:
            InvalidInput: A rig has something besides windings, poses, linear supplies and a uniform field; the message names it.
        """
        return CompiledSystem.of(self.parts, self.coils)

    def magnet(self) -> Magnet:
        """What exports write: the coils, each with the readings at which it carried current."""
        parts = []
        for part in self.parts:
            measured = self.calibrations[part.rig.coils[0].name]
            columns = [measured.rig.coils.index(coil) for coil in part.rig.coils]
            current_A = measured.observations.current_A[:, columns]
            parts.append(replace(part, observations=replace(measured.observations, current_A=current_A)))
        return Magnet(tuple(parts), self.coils)

    def export(
        self,
        to: str,
        path: Path | str | None = None,
        *,
        grid: Grid | None = None,
        currents_A: Mapping[str, float] | None = None,
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> Path:
        """Write all coils as one magnet for other programs, as `coilcal export CALIBRATION CALIBRATION ...` does.

        Args:
            to: Name of a format with a model or a grid, such as "cpp".
            path: File to write; one named after the rigs, in the current folder, where none is given.
            grid, currents_A, motion: Points, currents and poses, for formats that take them.
        Returns: The file.
        Raises:
            InvalidInput: An unknown format, something it does not take or lacks, or a model that it cannot express.
        """
        return formats.export(self.magnet(), to, path, grid=grid, currents_A=currents_A, motion=motion)

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

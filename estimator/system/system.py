"""Several calibrated coils on several arms as one magnet: field, gradient, force, their intervals, and currents for a wanted field.

Each coil's model comes from the calibration that measured it, so arms may be calibrated one coil at a time (paper, eq 14-17, 22). The sum
assumes that no coil drives another; `estimator.system.superposition` tests this on readings with all coils on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from jaxtyping import Float

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput, check_known
from estimator.export.formats import Exportable
from estimator.export.magnet import Magnet
from estimator.glance import Glance
from estimator.points import given_points
from estimator.system.compiled import CompiledSystem
from estimator.system.parts import CalibratedCoils
from estimator.system.system_field import SystemField
from estimator.tensors import Tensor

Motion = Mapping[str, Float[Tensor, "... 6"]]


@dataclass(frozen=True, repr=False)
class System(CalibratedCoils, Exportable):
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

"""A calibrated magnet whose movers move and whose calibration may be replaced; no ROS in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from estimator import Calibration, InvalidInput, Registry, System
from estimator.rig.bodies import Mover

Vector = Sequence[float]


class LiveMagnet:
    """Field and currents at one point, for the poses that the movers have now.

    Args:
        folders: Calibrations, or registries, of which the version in use is taken.
        most_A: Largest magnitude of a current; None sets no bound.
    """

    def __init__(self, folders: Sequence[str], most_A: float | None = None) -> None:
        self._folders = tuple(map(Path, folders))
        self._most_A = most_A
        self._system = System.of(*map(_calibration, self._folders))
        self._motion: dict[str, Tensor] = {}

    @property
    def coils(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return self._system.coils

    @property
    def movers(self) -> Mapping[str, Mover]:
        """Movers by name."""
        return {mover.name: mover for part in self._system.parts for mover in part.rig.movers}

    def move(self, mover: str, motion: Vector) -> None:
        """Where a mover is: six numbers in the order of its columns, in SI units."""
        self._motion[mover] = torch.tensor(motion, dtype=torch.float64)

    def field_T(self, point_m: Vector, currents_A: Vector) -> list[float]:
        """Field at a point of the world frame.

        Raises:
            InvalidInput: Another number of currents, or a mover whose pose is not known yet.
        """
        if len(currents_A) != len(self.coils):
            raise InvalidInput(
                f"currents must be one for each of {', '.join(self.coils)}; received {len(currents_A)}"
            )
        field_T = self._here(point_m).field_T(torch.tensor(currents_A, dtype=torch.float64))
        return [float(component) for component in field_T[0]]

    def currents_A(self, point_m: Vector, field_T: Vector) -> list[float]:
        """Currents that come closest to a field at a point, the smallest ones if there are several.

        Raises:
            InvalidInput: As `field_T`, or a core that saturates.
        """
        wanted_T = torch.tensor([list(field_T)], dtype=torch.float64)
        found_A = self._here(point_m).currents_for_field(wanted_T, self._most_A)
        return [float(current) for current in found_A[0]]

    def reload(self) -> str:
        """Read the calibrations again; what is in use stays where they cannot be read or hold other coils or movers.

        Returns: What was loaded, in words.
        Raises:
            InvalidInput: They cannot take the place of those in use.
        """
        system = System.of(*map(_calibration, self._folders))
        movers = {mover.name: mover.columns for part in system.parts for mover in part.rig.movers}
        before = {name: mover.columns for name, mover in self.movers.items()}
        if system.coils != self.coils or movers != before:
            raise InvalidInput(
                f"a new calibration must have the same coils and movers ({', '.join((*self.coils, *before))}); "
                f"received {', '.join((*system.coils, *movers))}"
            )
        self._system = system
        return f"{', '.join(map(str, self._folders))} in use"

    def _here(self, point_m: Vector):  # type: ignore[no-untyped-def]
        return self._system.at(torch.tensor([list(point_m)], dtype=torch.float64), self._motion)


def _calibration(folder: Path) -> Calibration:
    return Registry(folder).calibration() if (folder / "current").exists() else Calibration.load(folder)

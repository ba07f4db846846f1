"""Directions in which predictions are differentiated: coordinates that no reading shares take one direction together.

What belongs to a sensor changes its own readings only. With six probes of twenty numbers each, twenty directions give the derivatives
in all 120 numbers: the Jacobian is compressed by colouring its columns.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.effects import EFFECTS
from estimator.effects.base import Kind
from estimator.effects.stages import RecordEffect
from estimator.effects.use import uses_of
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

EVERY = -1  # readings of all sensors


@dataclass(frozen=True)
class Directions:
    """Directions that together tell the derivatives in every coordinate.

    Attributes:
        each: The directions, rows of zeros and ones.
        of_coordinate: Number of the direction that holds each coordinate that is asked for.
        sensor: Sensor whose readings such a coordinate changes; `EVERY` where it may change all.

    References: A. Curtis, M. Powell and J. Reid, J. Inst. Math. Appl. 13, 117 (1974).
    """

    each: Float[Tensor, "direction coordinate"]
    of_coordinate: Int[Tensor, " asked"]
    sensor: Int[Tensor, " asked"]

    @classmethod
    def of(cls, rig: Rig, coordinates: Coordinates) -> Directions:
        """Those of the continuous coordinates of a rig."""
        names = coordinates.names[: coordinates.n_continuous]
        owners = [_owner(rig, name) for name in names]
        n_own, shared, number = Counter[int](), dict[int, int](), []
        n_directions = 0
        # Numbered as they come, so that directions that nothing shares are the coordinates.
        for owner in owners:
            direction = n_directions if owner == EVERY else shared.setdefault(n_own[owner], n_directions)
            n_own[owner] += 1
            n_directions = max(n_directions, direction + 1)
            number.append(direction)
        device = coordinates.device
        of_coordinate = torch.tensor(number, dtype=torch.int64, device=device)
        each = torch.zeros(n_directions, len(names), dtype=torch.float64, device=device)
        each[of_coordinate, torch.arange(len(names), device=device)] = 1.0
        return cls(each, of_coordinate, torch.tensor(owners, dtype=torch.int64, device=device))

    def only(self, columns: Int[Tensor, " column"]) -> Directions:
        """Those of some coordinates; derivatives are then by these, in the given order."""
        number, of_column = torch.unique(self.of_coordinate[columns], return_inverse=True)
        is_asked = torch.zeros(len(self.of_coordinate), dtype=self.each.dtype, device=self.each.device)
        is_asked[columns] = 1.0
        return Directions(self.each[number] * is_asked, of_column, self.sensor[columns])

    @property
    def is_compressed(self) -> bool:
        """Whether some coordinates share a direction."""
        return len(self.each) < len(self.of_coordinate)

    def jacobian(
        self, along: Float[Tensor, "*batch component direction"], sensor: Int[Tensor, " component"]
    ) -> Float[Tensor, "*batch component asked"]:
        """Derivatives in every coordinate that is asked for, of those along the directions.

        Args:
            along: The latter.
            sensor: Of each component.
        """
        if torch.equal(self.of_coordinate, torch.arange(along.shape[-1], device=along.device)):
            return along
        is_own = (self.sensor == EVERY) | (self.sensor == sensor[:, None])
        result: Tensor = along[..., self.of_coordinate].masked_fill_(~is_own, 0.0)
        return result


def _owner(rig: Rig, name: str) -> int:
    """Index of the sensor that a parameter belongs to; `EVERY` where it has another place, or may change readings of others."""
    if uses_of(rig, RecordEffect):  # which may exchange the sensors
        return EVERY
    label, _, _ = name.partition(".")
    cause, _, place = label.partition("[")
    if place and EFFECTS[cause].kind is not Kind.SENSOR:
        return EVERY
    ties = {parameter.tie.to for parameter in rig.parameters.values() if parameter.tie is not None}
    owners = [sensor.name for sensor in rig.sensors]
    owner = place.rstrip("]") or label
    return owners.index(owner) if owner in owners and name not in ties else EVERY

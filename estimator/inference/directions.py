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
from estimator.effects.stages import ElementEffect, HolderEffect, MotionEffect, MountEffect, RecordEffect
from estimator.effects.use import uses_of
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

EVERY = -1  # readings of all sensors
POSES, SCALES = "poses", "scales"  # paths of what moves sensors, and of their gains and noise


@dataclass(frozen=True)
class Directions:
    """Directions that together tell the derivatives in every coordinate.

    Attributes:
        each: The directions, rows of zeros and ones.
        of_coordinate: Number of the direction that holds each coordinate that is asked for.
        sensor: Sensor whose readings such a coordinate changes; `EVERY` where it may change all.
        paths: Numbers of the directions whose coordinates act through the same part of the model.

    References: A. Curtis, M. Powell and J. Reid, J. Inst. Math. Appl. 13, 117 (1974).
    """

    each: Float[Tensor, "direction coordinate"]
    of_coordinate: Int[Tensor, " asked"]
    sensor: Int[Tensor, " asked"]
    paths: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, rig: Rig, coordinates: Coordinates) -> Directions:
        """Directions for the continuous coordinates of a rig."""
        names = coordinates.names[: coordinates.n_continuous]
        owners = [_owner(rig, name) for name in names]
        n_own, shared, number = Counter[tuple[int, str]](), dict[tuple[str, int], int](), []
        paths = dict[str, list[int]]()
        n_directions = 0
        # Numbered as they come, so that directions that nothing shares are the coordinates.
        for name, owner in zip(names, owners, strict=True):
            path = _path(rig, name, owner)
            direction = n_directions
            if owner != EVERY:
                direction = shared.setdefault((path, n_own[owner, path]), n_directions)
                n_own[owner, path] += 1
            if direction == n_directions:
                paths.setdefault(path, []).append(direction)
                n_directions += 1
            number.append(direction)
        device = coordinates.device
        of_coordinate = torch.tensor(number, dtype=torch.int64, device=device)
        each = torch.zeros(n_directions, len(names), dtype=torch.float64, device=device)
        each[of_coordinate, torch.arange(len(names), device=device)] = 1.0
        sensor = torch.tensor(owners, dtype=torch.int64, device=device)
        return cls(each, of_coordinate, sensor, tuple(map(tuple, paths.values())))

    def only(self, columns: Int[Tensor, " column"]) -> Directions:
        """Directions for some of the coordinates; derivatives are then by these, in the given order."""
        number, of_column = torch.unique(self.of_coordinate[columns], return_inverse=True)
        is_asked = torch.zeros(len(self.of_coordinate), dtype=self.each.dtype, device=self.each.device)
        is_asked[columns] = 1.0
        new = {old: i for i, old in enumerate(number.tolist())}
        paths = [tuple(new[old] for old in path if old in new) for path in self.paths]
        return Directions(
            self.each[number] * is_asked,
            of_column,
            self.sensor[columns],
            tuple(path for path in paths if path),
        )

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
        return along[..., self.of_coordinate].masked_fill_(~is_own, 0.0)


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


def _path(rig: Rig, name: str, owner: int) -> str:
    """The path by which a parameter acts. Parameters that move sensors share one; causes, coils and scales of sensors have their own."""
    label, _, key = name.partition(".")
    cause, _, place = label.partition("[")
    if place:
        moves = isinstance(EFFECTS[cause], MotionEffect | MountEffect | ElementEffect | HolderEffect)
        return POSES if moves else label if owner == EVERY else cause
    if label in {coil.name for coil in rig.coils}:
        return label
    return POSES if "_from_" in key else SCALES

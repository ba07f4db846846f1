"""Goals of a measurement, as numbers with units: how well a field or some parameters shall be known.

A goal is turned into rows: derivatives of its numbers in the coordinates of a fit, over their targets. A number whose row has a standard
deviation of 1 has a 90 % interval of just the wanted half-width.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from jaxtyping import Float

from estimator.derivatives import value_and_jacobian
from estimator.errors import InvalidInput
from estimator.model.room_field import RoomField
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.coordinates import Coordinates
from estimator.tensors import Tensor, torch


@dataclass(frozen=True)
class FieldGoal:
    """Half-width of the 90 % interval of each component of a coil's field in a workspace, each coil alone at its largest current.

    It is the field that the current adds: what is there without current, such as the Earth's field, does not count.

    Attributes:
        half_width: In tesla, or as a share of the root mean square of the field in the workspace.
        is_share: Which of both.
        is_worst: Whether the least known component at any point counts; else the root mean square of all.
        points_m: Points of the workspace in the world frame, with all movers at zero.
        largest_A: Current of each coil.
        names: Parameters that its numbers are of; none.
    """

    text: str
    half_width: float
    is_share: bool
    is_worst: bool
    points_m: Float[Tensor, "point 3"]
    largest_A: Mapping[str, float]
    names: tuple[str, ...] = ()

    def rows(
        self, coordinates: Coordinates, at: Float[Tensor, "draw all"]
    ) -> Float[Tensor, "draw number all"]:
        """Rows of each coil, point and component, at each draw.

        Args:
            coordinates: Of the rig that is fitted.
            at: Where the derivatives are taken, a row each.
        """
        rig = coordinates.rig
        room = RoomField(rig, coordinates.values(coordinates.start()), self.points_m)
        if bool(room.is_inside.any()):
            raise InvalidInput(
                f"workspace must lie outside the windings; {int(room.is_inside.sum())} of its {len(self.points_m)} points "
                f"do not (goal {self.text!r})"
            )
        each_A = torch.diag(at.new_tensor([self.largest_A[coil.name] for coil in rig.coils]))
        alone_A = each_A[each_A.any(-1)]
        current_A = torch.cat((alone_A, torch.zeros_like(each_A[:1])))[
            :, None
        ]  # the windings are summed once

        def added_T(values: Mapping[str, Tensor]) -> Tensor:
            field_T = room.field_T(values, current_A)
            return field_T[:-1] - field_T[-1]

        field_T, slopes = _slopes(added_T, coordinates, at)  # coil, draw, point, component
        share_T = field_T.square().sum(-1).mean(-1).sqrt()[..., None, None, None]
        rows = (slopes / share_T if self.is_share else slopes).flatten(2, 3)
        return rows.movedim(0, 1).flatten(1, 2) * (HALF_WIDTH_90 / self.half_width)


@dataclass(frozen=True)
class ParametersGoal:
    """Half-width of the 90 % interval of each of some free parameters; sizes of causes are such, too.

    Attributes:
        half_widths: By name, in the parameter's SI unit.
    """

    text: str
    half_widths: Mapping[str, float]
    is_worst: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that its numbers are of."""
        return tuple(self.half_widths)

    def rows(
        self, coordinates: Coordinates, at: Float[Tensor, "draw all"]
    ) -> Float[Tensor, "draw number all"]:
        """A row of each parameter, at each draw.

        Args:
            coordinates: Of the rig that is fitted.
            at: Where the derivatives are taken, a row each.
        """

        def wanted(values: Mapping[str, Tensor]) -> Tensor:
            return torch.stack([values[n] / w for n, w in self.half_widths.items()], dim=-1)

        return _slopes(wanted, coordinates, at)[1] * HALF_WIDTH_90


Goal: TypeAlias = FieldGoal | ParametersGoal


def _slopes(
    function: Callable[[Mapping[str, Tensor]], Tensor], coordinates: Coordinates, at: Tensor
) -> tuple[Tensor, Tensor]:
    """Values of a function at each draw, and their derivatives in the coordinates: all draws take the same step."""
    return value_and_jacobian(lambda step: function(coordinates.values(at + step)), torch.zeros_like(at[0]))

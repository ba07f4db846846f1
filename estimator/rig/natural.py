"""From one free number of a rig to a coordinate, and back: the number itself, its logarithm, or a size that its winding determines better.

The rms radius of the loops replaces the external radius, sides and corner radius of the mean loop those of the bore, and the position of
the winding's middle that of its front face (docs/decisions/0007).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from jaxtyping import Float

from estimator.frames import rotation_from_vector
from estimator.rig.parameters import Parameter
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

# Of the winding's thickness, by which the mean loop is larger than the bore.
SHARE_OF_THICKNESS = {"inner_side_x_m": 1.0, "inner_side_y_m": 1.0, "inner_corner_radius_m": 0.5}

Resolve: TypeAlias = Callable[[str], Tensor]
"""Gives the value of another number of the rig by its name."""

Number: TypeAlias = Float[Tensor, "*batch"]


@dataclass(frozen=True)
class Natural:
    """A number that is its own coordinate; subclasses are other coordinates.

    Attributes:
        name: Of the parameter.
    """

    name: str

    @property
    def label(self) -> str:
        """Meaning of the coordinate, in words."""
        return self.name

    @property
    def quantity(self) -> str:
        """The quantity that the coordinate stands for, by its name in `summary.json`."""
        return self.name

    @property
    def coil(self) -> str:
        """Name of the coil that the number belongs to."""
        return self.name.partition(".")[0]

    def value(self, coordinate: Number, resolve: Resolve) -> Number:
        """The number at a coordinate."""
        return coordinate

    def coordinate(self, value: Number, resolve: Resolve) -> Number:
        """The coordinate of a number."""
        return value

    def log_slope(self, value: Number, resolve: Resolve) -> Number | float:
        """Logarithm of the derivative of the number in its coordinate."""
        return 0.0


class Logarithm(Natural):
    """A positive number, by its logarithm."""

    def value(self, coordinate: Number, resolve: Resolve) -> Number:
        """The number whose logarithm the coordinate is."""
        return torch.exp(coordinate)

    def coordinate(self, value: Number, resolve: Resolve) -> Number:
        """The logarithm of the number."""
        return torch.log(value)

    def log_slope(self, value: Number, resolve: Resolve) -> Number:
        """The logarithm of the number, which is its own derivative in that."""
        return torch.log(value)


class ExternalRadius(Natural):
    """The radius around all layers, by the rms radius of the loops."""

    @property
    def label(self) -> str:
        """The rms radius, in words."""
        return f"{self.coil} rms radius"

    @property
    def quantity(self) -> str:
        """The rms radius, by its name in `summary.json`."""
        return f"{self.coil}.rms_radius_m"

    def value(self, coordinate: Number, resolve: Resolve) -> Number:
        """The external radius at a rms radius of the loops."""
        half_m, variance_m2 = self._layers(resolve)
        return half_m + torch.sqrt(coordinate**2 - variance_m2)

    def coordinate(self, value: Number, resolve: Resolve) -> Number:
        """The rms radius of the loops."""
        half_m, variance_m2 = self._layers(resolve)
        return torch.sqrt((value - half_m) ** 2 + variance_m2)

    def log_slope(self, value: Number, resolve: Resolve) -> Number:
        """Logarithm of rms over mean radius."""
        half_m, variance_m2 = self._layers(resolve)
        return 0.5 * torch.log1p(variance_m2 / (value - half_m) ** 2)

    def _layers(self, resolve: Resolve) -> tuple[Tensor, Tensor]:
        """Half the thickness of the winding, and the variance of the radii of its loops."""
        pitch_m, loops = resolve(f"{self.coil}.radial_pitch_m"), resolve(f"{self.coil}.radial_loops")
        return 0.5 * pitch_m * loops, pitch_m**2 * (loops**2 - 1.0) / 12.0


class BoreSize(Natural):
    """A side or the corner radius of the bore, by that of the mean loop."""

    @property
    def label(self) -> str:
        """Side or corner radius of the mean loop, in words."""
        return f"{self.coil} {self._quantity[len('inner_') : -len('_m')].replace('_', ' ')} of the mean loop"

    def value(self, coordinate: Number, resolve: Resolve) -> Number:
        """The size of the bore, given that of the mean loop."""
        return coordinate - self._to_mean_loop(resolve)

    def coordinate(self, value: Number, resolve: Resolve) -> Number:
        """The size of the mean loop, given that of the bore."""
        return value + self._to_mean_loop(resolve)

    @property
    def _quantity(self) -> str:
        return self.name.partition(".")[2]

    def _to_mean_loop(self, resolve: Resolve) -> Tensor:
        """Size of the mean loop less that of the bore."""
        thickness_m = resolve(f"{self.coil}.radial_pitch_m") * resolve(f"{self.coil}.radial_loops")
        return SHARE_OF_THICKNESS[self._quantity] * thickness_m


@dataclass(frozen=True)
class FrontPosition(Natural):
    """A position of the front face, by that of the winding's middle.

    Attributes:
        along: Component of the nominal axis along this coordinate; tilts add a nearly linear term.
    """

    along: float

    @property
    def label(self) -> str:
        """Position of the middle, in words."""
        return f"{self.name} of the winding's middle"

    def value(self, coordinate: Number, resolve: Resolve) -> Number:
        """The position of the front face, given that of the middle."""
        return coordinate + self._to_front(resolve)

    def coordinate(self, value: Number, resolve: Resolve) -> Number:
        """The position of the middle, given that of the front face."""
        return value - self._to_front(resolve)

    def _to_front(self, resolve: Resolve) -> Tensor:
        """Shift from the middle to the front face."""
        return 0.5 * self.along * resolve(f"{self.coil}.axial_pitch_m") * resolve(f"{self.coil}.axial_loops")


def natural_of(rig: Rig, parameters: Sequence[Parameter], counts: Collection[Parameter]) -> list[Natural]:
    """The coordinate of each free parameter.

    Args:
        rig: Whose parameters they are.
        parameters: The free ones.
        counts: Those among them that are whole numbers, which stay as they are.
    """
    along = _along_axes(rig)

    def natural(parameter: Parameter) -> Natural:
        coil, _, quantity = parameter.name.partition(".")
        if quantity == "radius_m" and f"{coil}.radial_loops" in rig.parameters:
            return ExternalRadius(parameter.name)
        if quantity in SHARE_OF_THICKNESS:
            return BoreSize(parameter.name)
        if parameter.name in along:
            return FrontPosition(parameter.name, along[parameter.name])
        is_log = parameter.is_positive and parameter not in counts
        return Logarithm(parameter.name) if is_log else Natural(parameter.name)

    return [natural(parameter) for parameter in parameters]


def _along_axes(rig: Rig) -> dict[str, float]:
    """Component of the nominal axis along each position coordinate, for coils whose length may change."""
    nominal = rig.nominal_values()
    along: dict[str, float] = {}
    for coil in rig.wound:
        if not any(rig.depends_on_data(f"{coil.name}.{key}") for key in ("axial_pitch_m", "axial_loops")):
            continue
        for block in ("world_from_coil", "world_from_coil0", "flange_from_coil"):
            prefix = f"{coil.name}.{block}"
            if f"{prefix}.rx_rad" not in nominal:
                continue
            nominal_rotation, about_body_axes = (
                rotation_from_vector(torch.tensor([nominal[f"{prefix}.{key}"] for key in keys]).double())
                for keys in (("rx_rad", "ry_rad", "rz_rad"), ("tilt_x_rad", "tilt_y_rad", "spin_rad"))
            )
            axis = (nominal_rotation @ about_body_axes)[:, 2].tolist()
            names = [f"{prefix}.{key}" for key in ("x_m", "y_m", "z_m")]
            along |= {name: part for name, part in zip(names, axis, strict=True) if abs(part) > 1e-9}
    return along

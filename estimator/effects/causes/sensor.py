"""What a three-axis Hall sensor says instead of the field."""

from __future__ import annotations

from itertools import permutations
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, normal, shape, triple
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import ElementEffect, ReadingEffect
from estimator.tensors import Tensor, torch

CLIPPED_AT = (0.999, 0.99, 0.98, 0.97, 0.95, 0.92, 0.88, 0.82, 0.75, 0.65, 0.5)
# xy: what the x axis picks up of the y component.
PAIRS = tuple("".join(pair) for pair in permutations("xyz", 2))


def _vector(theta: Theta, keys: tuple[str, ...]) -> Tensor:
    """Quantities as a vector per reading."""
    return torch.stack([theta[key] for key in keys], dim=-1)[..., None, :]


class AxisGain(ReadingEffect):
    """Each axis has a gain of its own."""

    name: ClassVar[str] = "axis_gain"
    words: ClassVar[str] = "the sensor's axes have wrong gains"
    source: ClassVar[str] = "Hall teslameters are specified to 0.1 to 1 % (Metrolab THM1176: 1 %)"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of each gain."""
        return triple("xyz", "", "1", 0.01)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T * (1.0 + _vector(theta, ("x", "y", "z")))


class CrossAxis(ReadingEffect):
    """Each axis picks up a share of the other components."""

    name: ClassVar[str] = "cross_axis"
    words: ClassVar[str] = "the sensor's axes pick up each other's components"
    source: ClassVar[str] = "elements are mounted to 0.2 to 1 degree; cross sensitivity up to 1 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """`xy` is what the x axis picks up of the y component."""
        return tuple(normal(pair, "1", 0.01) for pair in PAIRS)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        zero = torch.zeros_like(theta["xy"])
        rows = [[theta[a + b] if a != b else zero for b in "xyz"] for a in "xyz"]
        mix = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
        return field_sensor_T + (mix[..., None, :, :] @ field_sensor_T[..., None])[..., 0]


class ElementDisplacement(ElementEffect):
    """The elements of the three axes sit at different positions in the probe.

    A shift that all three share looks like another place of the sensor. So each number by itself stays as wide as its prior where that
    place is free, and differences such as `z_at_x_m - x_at_x_m` are known far better.
    """

    name: ClassVar[str] = "element_displacement"
    words: ClassVar[str] = "the sensor's three elements sit at different positions"
    source: ClassVar[str] = "probes of separate elements: 0.1 to 2 mm; integrated ones below 0.1 mm"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Position of each element from where the sensor is said to be, in the sensor frame."""
        return tuple(normal(f"{element}_at_{axis}_m", "m", 500e-6) for element in "xyz" for axis in "xyz")

    def apply(self, theta: Theta) -> Float[Tensor, "*batch 3 3"]:
        """Position of the x, y and z element."""
        rows = [torch.stack([theta[f"{e}_at_{axis}_m"] for axis in "xyz"], dim=-1) for e in "xyz"]
        return torch.stack(rows, dim=-2)


class SensorOffset(ReadingEffect):
    """The sensor shows a constant in no field."""

    name: ClassVar[str] = "sensor_offset"
    words: ClassVar[str] = "the sensor shows a constant in no field"
    source: ClassVar[str] = "zero errors of Hall sensors, 10 to 100 uT"
    is_everywhere: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Components in the sensor frame."""
        return triple("xyz", "_T", "T", 50e-6)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T + _vector(theta, ("x_T", "y_T", "z_T"))


class OffsetDrift(ReadingEffect):
    """The zero of the sensor moves steadily."""

    name: ClassVar[str] = "offset_drift"
    words: ClassVar[str] = "the zero of the sensor drifts"
    source: ClassVar[str] = "some 10 uT while electronics warm up"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Change per hour in the sensor frame, from the beginning of the session on."""
        return triple("xyz", "_T_per_h", "T/h", 50e-6 / extent.duration_h)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        rate = _vector(theta, ("x_T_per_h", "y_T_per_h", "z_T_per_h"))
        return field_sensor_T + rate * circumstances.hours[:, None]


class CubicResponse(ReadingEffect):
    """The response bends: a relative error that grows with the square of the component."""

    name: ClassVar[str] = "cubic_response"
    words: ClassVar[str] = "the sensor's response bends with the field"
    source: ClassVar[str] = "linearity of Hall sensors, 0.1 to 1 % of range"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative error per square tesla of each axis."""
        return triple("xyz", "_per_T2", "1/T2", 0.01 / extent.largest_field_T**2)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        bend = _vector(theta, ("x_per_T2", "y_per_T2", "z_per_T2"))
        return field_sensor_T + bend * field_sensor_T**3


class PlanarHall(ReadingEffect):
    """The planar Hall effect: each axis adds the product of the two components in its plane."""

    name: ClassVar[str] = "planar_hall"
    words: ClassVar[str] = "each axis adds the product of the two other components"
    source: ClassVar[str] = "planar Hall voltage of silicon elements, up to 1 % of the field"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Reading of each axis per product of the other two components."""
        return triple("xyz", "_per_T", "1/T", 0.01 / extent.largest_field_T)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        x, y, z = field_sensor_T.unbind(-1)
        product = torch.stack((y * z, z * x, x * y), dim=-1)
        return field_sensor_T + _vector(theta, ("x_per_T", "y_per_T", "z_per_T")) * product


class RangeClipping(ReadingEffect):
    """Components beyond the range read as its end."""

    name: ClassVar[str] = "range_clipping"
    words: ClassVar[str] = "components beyond the sensor's range are cut off"
    source: ClassVar[str] = "any range; the readings show where it ends"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Largest component that is shown."""
        largest_T = extent.largest_field_T
        clipped = shape("limit_T", "T", 0.2 * largest_T, 3.0 * largest_T)
        return (Quantity("limit_T", "T", clipped.prior, 3.0 * largest_T),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Just inside the sensor's largest reading, where a limit gathers readings."""
        largest_T = circumstances.largest_of_sensor_T(place)
        return tuple({"limit_T": share * largest_T} for share in CLIPPED_AT)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        limit = theta["limit_T"][..., None, None]
        return torch.minimum(torch.maximum(field_sensor_T, -limit), limit)


class TemperatureDrift(ReadingEffect):
    """Gain and zero of the sensor follow its temperature."""

    name: ClassVar[str] = "temperature_drift"
    words: ClassVar[str] = "the sensor's gain and zero follow its temperature"
    source: ClassVar[str] = "temperature coefficients of Hall sensors: 100 to 1000 ppm/K, 1 to 10 uT/K"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative change of gain and change of zero per kelvin."""
        return (normal("gain_per_K", "1/K", 1e-3), *triple("xyz", "_T_per_K", "T/K", 5e-6))

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor's thermometer showed a change."""
        kelvin = circumstances.temperature_K(place)
        return kelvin is not None and bool(kelvin.abs().max() > 0.0)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        kelvin = circumstances.temperature_K(sensor)
        if kelvin is None:
            return field_sensor_T
        return at_temperature(field_sensor_T, theta, kelvin)


def at_temperature(
    field_sensor_T: Float[Tensor, "*#batch reading 3"], theta: Theta, kelvin: Float[Tensor, "*#batch reading"]
) -> Float[Tensor, "*#batch reading 3"]:
    """Components as a sensor reads them at a temperature of its own, by its gain and zero per kelvin."""
    zero = _vector(theta, ("x_T_per_K", "y_T_per_K", "z_T_per_K"))
    gain = theta["gain_per_K"][..., None, None]
    return field_sensor_T * (1.0 + gain * kelvin[..., None]) + zero * kelvin[..., None]

"""Mistakes of the record: axes, signs and units that mean something else than they say. They are there or not."""

from __future__ import annotations

from itertools import permutations, product
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.effects.base import CurrentEffect, Kind, MotionEffect, Quantity, ReadingEffect, Theta
from estimator.effects.scene import Extent, Scene
from estimator.frames import Transform
from estimator.parameters import Uniform
from estimator.rig import MotionKind, Rig

FACTORS = (1e3, 1e-3, 1e4, 1e-4, 10.0, 0.1)  # mT, uT, gauss, and a slip of the decimal point


RECORD = ("axes_swapped", "left_handed", "unit_error", "current_sign", "displacement_frame")


def _switch(key: str, lower: float, upper: float, null: float) -> Quantity:
    """A number that is set, not fitted."""
    return Quantity(key, "1", Uniform(lower, upper), null, is_shape=True, is_fixed=True)


class AxesSwapped(ReadingEffect):
    """The sensor's axes are named or wired in another order or direction."""

    name: ClassVar[str] = "axes_swapped"
    words: ClassVar[str] = "the sensor's axes are in another order or direction"
    source: ClassVar[str] = "47 signed permutations"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Which component, 1 to 3, each axis reads, negative where it is reversed."""
        return tuple(_switch(f"{axis}_reads", -3.0, 3.0, i + 1.0) for i, axis in enumerate("xyz"))

    def starts(self, scene: Scene) -> tuple[dict[str, float], ...]:
        """All but the right one, single reversals (`left_handed`) and the reversal of all (`current_sign`)."""
        taken = (0, 1, 3)  # reversals in the right order: none, left_handed, current_sign
        return tuple(
            s for s in _signed_permutations() if _order(s) != [1, 2, 3] or _reversals(s) not in taken
        )

    def apply(
        self, field_sensor_T: Float[Tensor, "*batch reading 3"], theta: Theta, scene: Scene, sensor: str
    ) -> Float[Tensor, "*batch reading 3"]:
        """Components as they are read."""
        reads = torch.stack([theta[f"{axis}_reads"] for axis in "xyz"], dim=-1)
        mix = torch.nn.functional.one_hot(reads.abs().round().long() - 1, 3).to(field_sensor_T.dtype)
        mix = mix * torch.sign(reads)[..., None]
        return (mix[..., None, :, :] @ field_sensor_T[..., None])[..., 0]


class LeftHanded(AxesSwapped):
    """One axis of the sensor is reversed, so that its frame is left-handed."""

    name: ClassVar[str] = "left_handed"
    words: ClassVar[str] = "one axis of the sensor is reversed: its frame is left-handed"
    source: ClassVar[str] = "3 axes"

    def starts(self, scene: Scene) -> tuple[dict[str, float], ...]:
        """Each axis alone."""
        return tuple(s for s in _signed_permutations() if _order(s) == [1, 2, 3] and _reversals(s) == 1)


class UnitError(ReadingEffect):
    """Readings are in another unit than the file says."""

    name: ClassVar[str] = "unit_error"
    words: ClassVar[str] = "the readings are in another unit than stated"
    source: ClassVar[str] = "powers of ten between T, G, mT, uT"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Number read per tesla."""
        return (_switch("factor", 0.0, 1e9, 1.0),)

    def starts(self, scene: Scene) -> tuple[dict[str, float], ...]:
        """The usual slips."""
        return tuple({"factor": factor} for factor in FACTORS)

    def apply(
        self, field_sensor_T: Float[Tensor, "*batch reading 3"], theta: Theta, scene: Scene, sensor: str
    ) -> Float[Tensor, "*batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T * theta["factor"][..., None, None]


class CurrentSign(CurrentEffect):
    """The leads of a coil are exchanged."""

    name: ClassVar[str] = "current_sign"
    kind: ClassVar[Kind] = Kind.COIL
    words: ClassVar[str] = "the coil is connected the other way round"
    source: ClassVar[str] = "there or not"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Sign of the current."""
        return (_switch("sign", -1.0, 1.0, 1.0),)

    def starts(self, scene: Scene) -> tuple[dict[str, float], ...]:
        """Reversed."""
        return ({"sign": -1.0},)

    def apply(
        self, current_A: Float[Tensor, "*batch reading coil"], theta: Theta, scene: Scene, coil: int
    ) -> Float[Tensor, "*batch reading coil"]:
        """Delivered currents."""
        sign = theta["sign"][..., None, None]
        return torch.where(torch.arange(current_A.shape[-1]) == coil, sign * current_A, current_A)


class DisplacementFrameError(MotionEffect):
    """Displacements are in the base frame though the rig says end effector, or turned by a quarter."""

    name: ClassVar[str] = "displacement_frame"
    words: ClassVar[str] = "displacements are reported in other axes than the rig says"
    source: ClassVar[str] = "24 right-handed choices of axes, or the sign of all"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Which reported axis, 1 to 3, each real one follows, negative where reversed."""
        return tuple(_switch(f"{axis}_from", -3.0, 3.0, i + 1.0) for i, axis in enumerate("xyz"))

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Movers that report displacements."""
        return tuple(m.name for m in rig.movers if m.motion is MotionKind.DISPLACEMENT)

    def starts(self, scene: Scene) -> tuple[dict[str, float], ...]:
        """All but the right one."""
        keys = {"x_reads": "x_from", "y_reads": "y_from", "z_reads": "z_from"}
        return tuple(
            {keys[k]: v for k, v in start.items()}
            for start in _signed_permutations()
            if list(start.values()) != [1.0, 2.0, 3.0]
        )

    def apply(self, pose: Transform, columns: Float[Tensor, "place column"], theta: Theta) -> Transform:
        """Real pose."""
        follows = torch.stack([theta[f"{axis}_from"] for axis in "xyz"], dim=-1)
        mix = torch.nn.functional.one_hot(follows.abs().round().long() - 1, 3).to(pose.translation_m.dtype)
        mix = (mix * torch.sign(follows)[..., None])[..., None, :, :]
        return Transform(pose.rotation, (mix @ pose.translation_m[..., None])[..., 0])


def _signed_permutations() -> list[dict[str, float]]:
    """The 48 of them, the identity first."""
    found = [
        {
            f"{axis}_reads": float(sign * column)
            for axis, sign, column in zip("xyz", signs, order, strict=True)
        }
        for order in permutations((1, 2, 3))
        for signs in product((1, -1), repeat=3)
    ]
    return found


def _order(start: dict[str, float]) -> list[int]:
    return [int(abs(value)) for value in start.values()]


def _reversals(start: dict[str, float]) -> int:
    return sum(value < 0.0 for value in start.values())

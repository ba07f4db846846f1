"""Mistakes of the record: axes, signs and units that are not what they are called. A mistake is present or absent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from itertools import combinations, permutations, product
from typing import ClassVar

from jaxtyping import Float, Int

from estimator.effects.base import Kind, Quantity, Theta, shape, switch
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import CurrentEffect, MotionEffect, ReadingEffect, RecordEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.rig.rig import MotionKind, Rig
from estimator.tensors import Tensor, torch

FIELD_FACTORS = (1e3, 1e6, 1e4, 10.0, 0.1, 1e-3)  # mT, uT and G under T; G under mT; mT under G; T under mT
SMALLEST_TURN_RAD = math.radians(15.0)
MOST_BODIES = 1000.0
CURRENT_FACTORS = (1e3, 1e-3)  # mA under A, A under mA


class AxesSwapped(ReadingEffect):
    """The sensor's axes are named or wired in another order or direction."""

    name: ClassVar[str] = "axes_swapped"
    words: ClassVar[str] = "the sensor's axes are in another order or direction"
    source: ClassVar[str] = "46 signed permutations; the reversal of all is current_sign"
    is_record_mistake: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Which component, 1 to 3, each axis reads, negative where it is reversed."""
        return tuple(switch(f"{axis}_reads", -3.0, 3.0, i + 1.0) for i, axis in enumerate("xyz"))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """All but the right one and its reversal."""
        right = ([1.0, 2.0, 3.0], [-1.0, -2.0, -3.0])
        return tuple(start for start in _signed_permutations() if list(start.values()) not in right)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        reads = torch.stack([theta[f"{axis}_reads"] for axis in "xyz"], dim=-1)
        mix = torch.nn.functional.one_hot(reads.abs().round().long() - 1, 3).to(field_sensor_T.dtype)
        mix = mix * torch.sign(reads)[..., None]
        return (mix[..., None, :, :] @ field_sensor_T[..., None])[..., 0]

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Every component is read once."""
        if sorted(abs(value) for value in values.values()) == [1.0, 2.0, 3.0]:
            return None
        return next(iter(values)), "must be, with the other two, 1, 2 and 3 in some order and with any signs"


class UnitError(RecordEffect):
    """Fields or currents are in another unit than the file says."""

    name: ClassVar[str] = "unit_error"
    words: ClassVar[str] = "fields or currents are in another unit than stated"
    source: ClassVar[str] = "powers of ten between T, G, mT, uT and between A, mA"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Recorded over true fields, which scales the noise too; recorded over true currents."""
        return (switch("field_factor", 0.0, 1e9, 1.0), switch("current_factor", 0.0, 1e9, 1.0))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Factors of the usual slips between units."""
        fields = [{"field_factor": factor, "current_factor": 1.0} for factor in FIELD_FACTORS]
        return (*fields, *({"field_factor": 1.0, "current_factor": factor} for factor in CURRENT_FACTORS))

    def commanded_A(
        self, recorded_A: Float[Tensor, "*#batch reading coil"], theta: Theta
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Commanded currents behind the recorded ones."""
        return recorded_A / theta["current_factor"][..., None, None]

    def recorded_T(
        self, field_sensor_T: Float[Tensor, "*#batch reading 3"], theta: Theta
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components in the unit of the record."""
        return field_sensor_T * theta["field_factor"][..., None, None]

    def recorded_error_T(
        self, error_T: Float[Tensor, "*#batch component"], theta: Theta
    ) -> Float[Tensor, "*#batch component"]:
        """Errors in the unit of the record."""
        return error_T * theta["field_factor"][..., None]

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Factors are positive."""
        return next(((key, "must be > 0") for key, value in values.items() if not value > 0.0), None)


class _Exchanged(RecordEffect):
    """Two bodies of a kind were taken for each other; their numbers in the rig file count from 1."""

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """The two, from 1 in the order of the rig file; a body exchanged with itself is where it should be."""
        return tuple(switch(key, 1.0, MOST_BODIES, 1.0) for key in ("first", "second"))

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Numbers of bodies are whole."""
        wrong = (key for key, value in values.items() if not (value >= 1.0 and value.is_integer()))
        return next(((key, "must be the number of a body, from 1") for key in wrong), None)


def _pairs(n_bodies: int) -> tuple[dict[str, float], ...]:
    return tuple({"first": float(i), "second": float(j)} for i, j in combinations(range(1, n_bodies + 1), 2))


def _exchanged(index: Int[Tensor, "*#batch row"], theta: Theta) -> Int[Tensor, "*#batch row"]:
    """Indices from 0 with the two exchanged."""
    first, second = (theta[key][..., None].round().long() - 1 for key in ("first", "second"))
    return torch.where(index == first, second, torch.where(index == second, first, index))


class SensorsExchanged(_Exchanged):
    """Two sensors stand at each other's places, or their cables are exchanged."""

    name: ClassVar[str] = "sensors_exchanged"
    words: ClassVar[str] = "two sensors stand at each other's places, or their cables are exchanged"
    source: ClassVar[str] = "any two sensors"

    def places(self, rig: Rig) -> tuple[str, ...]:
        """The record, where there are two sensors."""
        return super().places(rig) if len(rig.sensors) > 1 else ()

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Every pair of sensors."""
        return _pairs(len(circumstances.rig.sensors))

    def place_of(self, sensor: Int[Tensor, "*#batch row"], theta: Theta) -> Int[Tensor, "*#batch row"]:
        """Index of the sensor at whose place each reading was taken."""
        return _exchanged(sensor, theta)


class CoilsExchanged(_Exchanged):
    """The currents of two coils are exchanged."""

    name: ClassVar[str] = "coils_exchanged"
    words: ClassVar[str] = "two coils are connected in each other's place"
    source: ClassVar[str] = "any two coils"
    is_structural: ClassVar[bool] = True
    exchanges_coils: ClassVar[bool] = True

    def places(self, rig: Rig) -> tuple[str, ...]:
        """The record, where there are two coils."""
        return super().places(rig) if len(rig.coils) > 1 else ()

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Every pair of coils."""
        return _pairs(len(circumstances.rig.coils))

    def commanded_A(
        self, recorded_A: Float[Tensor, "*#batch reading coil"], theta: Theta
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Commanded currents behind the recorded ones."""
        source = _exchanged(torch.arange(recorded_A.shape[-1], device=recorded_A.device), theta)[..., None, :]
        recorded_A, source = torch.broadcast_tensors(recorded_A, source)
        return recorded_A.gather(-1, source)


class CurrentSign(CurrentEffect):
    """The leads of a coil are exchanged."""

    name: ClassVar[str] = "current_sign"
    kind: ClassVar[Kind] = Kind.COIL
    words: ClassVar[str] = "the coil is connected the other way round"
    source: ClassVar[str] = "there or not"
    is_structural: ClassVar[bool] = True
    is_record_mistake: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Sign of the delivered current over the commanded one."""
        return (switch("sign", -1.0, 1.0, 1.0),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Sign of a reversed coil."""
        return ({"sign": -1.0},)

    def apply(
        self,
        current_A: Float[Tensor, "*#batch reading coil"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Delivered currents."""
        sign = theta["sign"][..., None, None]
        return torch.where(
            torch.arange(current_A.shape[-1], device=current_A.device) == coil, sign * current_A, current_A
        )

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """A sign is a sign."""
        return next(((key, "must be 1 or -1") for key, value in values.items() if abs(value) != 1.0), None)


class LeftHanded(MotionEffect):
    """One axis of the recorded displacements is reversed, so that their frame is left-handed."""

    name: ClassVar[str] = "left_handed"
    words: ClassVar[str] = "one axis of the displacements is reversed: their frame is left-handed"
    source: ClassVar[str] = "3 axes"
    is_record_mistake: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Sign of each axis of the displacements."""
        return tuple(switch(f"{axis}_sign", -1.0, 1.0, 1.0) for axis in "xyz")

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Reversal of each axis alone, and of all."""
        alone = [{f"{b}_sign": -1.0 if a == b else 1.0 for b in "xyz"} for a in "xyz"]
        return (*alone, {f"{axis}_sign": -1.0 for axis in "xyz"})

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        sign = torch.stack([theta[f"{axis}_sign"] for axis in "xyz"], dim=-1)[..., None, :]
        return Transform(pose.rotation, sign * pose.translation_m)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """A sign is a sign."""
        return next(((key, "must be 1 or -1") for key, value in values.items() if abs(value) != 1.0), None)


class DisplacementFrameError(MotionEffect):
    """Displacements are reported in other axes than the rig says, such as those of the robot's base."""

    name: ClassVar[str] = "displacement_frame"
    words: ClassVar[str] = "displacements are reported in other axes than the rig says"
    source: ClassVar[str] = "any rotation: a tool may point anywhere"
    is_record_mistake: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Rotation vector from the reported to the real axes."""
        return tuple(
            shape(f"{axis}_rad", "rad", -2.0 * math.pi, 2.0 * math.pi) for axis in ("rx", "ry", "rz")
        )

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Movers that report displacements."""
        return tuple(m.name for m in rig.movers if m.motion is MotionKind.DISPLACEMENT)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The other 23 rotations of a cube, and those half way between about each of its axes."""
        keys = ("rx_rad", "ry_rad", "rz_rad")
        return tuple(dict(zip(keys, turn, strict=True)) for turn in _turns())

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose."""
        turn = rotation_from_vector(torch.stack([theta[f"{a}_rad"] for a in ("rx", "ry", "rz")], dim=-1))
        return Transform(pose.rotation, (turn[..., None, :, :] @ pose.translation_m[..., None])[..., 0])

    def is_itself(self, theta: Theta, circumstances: Circumstances) -> bool:
        """Whether the turn is large: axes that are turned a little are not mistaken for others."""
        return math.hypot(*(float(turn_rad) for turn_rad in theta.values())) > SMALLEST_TURN_RAD


def _signed_permutations() -> list[dict[str, float]]:
    """All 48 signed permutations of the axes, the identity first."""
    return [
        {
            f"{axis}_reads": float(sign * column)
            for axis, sign, column in zip("xyz", signs, order, strict=True)
        }
        for order in permutations((1, 2, 3))
        for signs in product((1, -1), repeat=3)
    ]


@cache
def _turns() -> tuple[tuple[float, ...], ...]:
    """Rotation vectors of turns in steps of 45 degrees about each axis, no two of them alike, without the identity."""
    steps = list(product(range(0, 360, 45), (-90, -45, 0, 45, 90), range(0, 360, 45)))
    from scipy.spatial.transform import Rotation  # a third of a second, which only rotations as numbers need

    distinct = Rotation.identity(1)
    for turn in Rotation.from_euler("XYZ", steps, degrees=True):
        if (turn.inv() * distinct).magnitude().min() > math.radians(44.0):
            distinct = Rotation.concatenate((distinct, turn))
    return tuple(tuple(vector) for vector in distinct[1:].as_rotvec().tolist())

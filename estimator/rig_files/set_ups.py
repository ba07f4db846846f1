"""First rig files and plans of the set-ups that laboratories build most: pairs, a cage, an array of sensors, a solenoid with a mapper.

In each of them the middle is the origin of the room, and what moves is a stage whose base is not known to a millimetre.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any

from estimator.errors import InvalidInput
from estimator.rig.first import RELATIVE_SD
from estimator.rig_files.starter import (
    Earth,
    Motion,
    Moved,
    Starter,
    check_name,
    effects,
    noise,
    normal,
    starter_plan_text,
    starter_rig_text,
)
from estimator.rig_files.wound import Wound, both_signs, plan_text_of, rig_text_of, round_coil

SQUARE_HELMHOLTZ = (
    0.5445  # distance of two square loops over their side, where the field is flattest in the middle
)
MAXWELL = math.sqrt(3.0)  # distance of two opposed loops over their radius, where the gradient is flattest
FACE_SD_MM = 1.0  # of the distance of two windings on one frame


class Kind(StrEnum):
    """A set-up that `coilcal init` knows."""

    STAGE = "stage"
    ARM = "arm"
    HELMHOLTZ = "helmholtz"
    MAXWELL = "maxwell"
    CAGE = "cage"
    ARRAY = "array"
    SOLENOID = "solenoid"


@dataclass(frozen=True)
class Pair(Wound):
    """A Helmholtz pair, whose currents flow alike, or a Maxwell pair, whose currents oppose each other; a stage maps its middle.

    Attributes:
        radius_mm: Outer radius of both windings.
        is_opposed: Whether it is a Maxwell pair.
    """

    radius_mm: float = 150.0
    is_opposed: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_bore("radius_mm", self.radius_mm * (1.0 - 2.0 * RELATIVE_SD) - self.thickness_mm)

    def texts(self) -> tuple[str, str]:
        """Rig file and plan."""
        mean_mm = self.radius_mm - 0.5 * self.thickness_mm
        half_mm = 0.5 * mean_mm * (MAXWELL if self.is_opposed else 1.0)
        radius = normal(self.radius_mm, RELATIVE_SD * self.radius_mm)
        words = (
            "Distance of the middles over the mean radius: 1.732, a Maxwell pair. Currents of opposite sign make a gradient."
            if self.is_opposed
            else "Distance of the middles over the mean radius: 1, a Helmholtz pair. Equal currents make a flat field."
        )
        coils = {
            "coil1": round_coil(self, radius, half_mm, ""),
            "coil2": round_coil(self, "{tied_to: coil1.radius_m}", -half_mm, "coil1", FACE_SD_MM),
        }
        sign = -1.0 if self.is_opposed else 1.0
        both = {"coil1": self.largest_A, "coil2": sign * self.largest_A}
        settings = both_signs([{"coil1": self.largest_A}, {"coil2": self.largest_A}, both])
        return rig_text_of(self, words, coils), plan_text_of(self, settings, self.reach_mm)


@dataclass(frozen=True)
class Cage(Wound):
    """Three pairs of square coils about one middle, each pair a little smaller than the one around it.

    Attributes:
        side_mm: Inner side of the largest pair, whose axis is x.
    """

    axial_loops: float = 5.0
    radial_loops: float = 6.0
    reach_mm: float = 100.0
    noise_uT: float = 1.0
    side_mm: float = 1000.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_bore("side_mm", 0.5 * self._side_mm("z") * SQUARE_HELMHOLTZ)

    def _side_mm(self, axis: str) -> float:
        """Inner side of a pair; a smaller one stands inside the frame of the larger."""
        return self.side_mm - 2.0 * "xyz".index(axis) * (self.thickness_mm + 5.0)

    def texts(self) -> tuple[str, str]:
        """Rig file and plan."""
        coils = {}
        turn = {"x": "ry_deg: 90", "y": "rx_deg: -90", "z": ""}
        for axis in "xyz":
            side_mm = self._side_mm(axis)
            half_mm = 0.5 * SQUARE_HELMHOLTZ * (side_mm + self.thickness_mm)
            for number, middle_mm in ((1, half_mm), (2, -half_mm)):
                face_mm = middle_mm + 0.5 * self.length_mm
                first = f"{axis}1"
                is_first = number == 1
                side = (
                    normal(side_mm, 0.002 * side_mm) if is_first else f"{{tied_to: {first}.inner_side_x_m}}"
                )
                wire = (
                    normal(self.wire_radius_mm, RELATIVE_SD * self.wire_radius_mm)
                    if is_first
                    else f"{{tied_to: {first}.wire_radius_m}}"
                )
                pose = ", ".join(filter(None, (f"{axis}_mm: {normal(face_mm, FACE_SD_MM)}", turn[axis])))
                coils[f"{axis}{number}"] = (
                    f"    model: rectangular\n    inner_side_x_mm: {side}\n"
                    f"    inner_side_y_mm: {{tied_to: {axis}{number}.inner_side_x_m}}\n    wire_radius_mm: {wire}\n"
                    f"    axial_loops: {self.axial_loops:g}\n    radial_loops: {self.radial_loops:g}\n"
                    f"    world_from_coil: {{{pose}}}\n"
                )
        words = "Two windings of a pair in series have the same current in both of their columns, such as x1_current_A and x2_current_A."
        pairs = [{f"{axis}1": self.largest_A, f"{axis}2": self.largest_A} for axis in "xyz"]
        return rig_text_of(self, words, coils), plan_text_of(self, both_signs(pairs), self.reach_mm)


@dataclass(frozen=True)
class Solenoid(Wound):
    """A long coil, and a mapper that carries a sensor through it.

    Attributes:
        radius_mm: Outer radius.
    """

    axial_loops: float = 200.0
    radial_loops: float = 4.0
    reach_mm: float = 15.0
    radius_mm: float = 45.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_bore("radius_mm", self.radius_mm * (1.0 - 2.0 * RELATIVE_SD) - self.thickness_mm)

    def texts(self) -> tuple[str, str]:
        """Rig file and plan."""
        radius = normal(self.radius_mm, RELATIVE_SD * self.radius_mm)
        coils = {"coil1": round_coil(self, radius, 0.0, "", frees_turns=True)}
        words = "The middle of the solenoid is the origin of the room, its axis is z."
        settings = both_signs([{"coil1": self.largest_A}, {"coil1": 0.5 * self.largest_A}])
        return rig_text_of(self, words, coils), plan_text_of(self, settings, 0.75 * self.length_mm)


@dataclass(frozen=True)
class Array(Starter):
    """A coil that a stage carries before fixed sensors on a square.

    Attributes:
        spacing_mm: Distance of neighbouring sensors.
        n_sensors: How many there are.
    """

    distance_mm: float = 40.0
    spacing_mm: float = 30.0
    n_sensors: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 2 <= self.n_sensors <= 64:
            raise InvalidInput(f"n_sensors must be from 2 to 64; received {self.n_sensors}")

    def texts(self) -> tuple[str, str]:
        """Rig file and plan."""
        names = [f"s{number}" for number in range(1, self.n_sensors + 1)]
        n_side = math.ceil(math.sqrt(len(names)))
        rig = starter_rig_text(self)
        before, _, rest = rig.partition("sensors:\n")
        tail = effects(names, self.earth)
        assert rest.endswith(effects(("hall",), self.earth))
        middle = 0.5 * (n_side - 1) * self.spacing_mm
        lines = [
            "sensors:\n    # The middle of the array is the origin of the room; the first sensor is at its place exactly.\n"
        ]
        for number, name in enumerate(names):
            x_mm, y_mm = (
                (number % n_side) * self.spacing_mm - middle,
                (number // n_side) * self.spacing_mm - middle,
            )
            pose = (
                f"{{x_mm: {x_mm:g}, y_mm: {y_mm:g}}}"
                if number == 0
                else f"{{x_mm: {normal(x_mm, FACE_SD_MM)}, y_mm: {normal(y_mm, FACE_SD_MM)}, z_mm: {normal(0.0, FACE_SD_MM)}}}"
            )
            gain = "1" if number == 0 else normal(1.0, 0.01)
            lines.append(
                f"  {name}:\n    noise_uT: {noise(self.noise_uT)}\n    gain: {gain}\n    world_from_sensor: {pose}\n"
            )
        return f"{before}{''.join(lines)}\n{tail}", starter_plan_text(self)


def texts_of(kind: Kind, answers: Mapping[str, object]) -> tuple[str, str]:
    """Rig file and plan of a set-up.

    Args:
        kind: Which.
        answers: What the user said, by the names of the attributes; what is left out is as usual.
    Raises:
        InvalidInput: An answer is impossible, alone or with others; the sentence begins with its name.
    Examples:
        >>> rig_text, plan_text = texts_of(Kind.HELMHOLTZ, {"radius_mm": 100.0})
        >>> "a Helmholtz pair" in rig_text
        True
    """
    given: dict[str, Any] = dict(answers)
    for key, words in WORDS.items():
        if key in given:
            given[key] = words(given[key])
    set_up = SET_UPS[kind](**FIXED.get(kind, {}) | given)
    return (
        (starter_rig_text(set_up), starter_plan_text(set_up)) if type(set_up) is Starter else set_up.texts()
    )


def defaults_of(kind: Kind) -> dict[str, Any]:
    """What is usual in a set-up, by the names of the attributes."""
    usual = SET_UPS[kind](**FIXED.get(kind, {}))
    return {
        field.name: str(value) if isinstance(value := getattr(usual, field.name), StrEnum) else value
        for field in fields(usual)
    }


WORDS: dict[str, Any] = {"name": check_name, "moved": Moved, "motion": Motion, "earth": Earth}
SET_UPS: dict[Kind, Any] = {
    Kind.STAGE: Starter,
    Kind.ARM: Starter,
    Kind.HELMHOLTZ: Pair,
    Kind.MAXWELL: Pair,
    Kind.CAGE: Cage,
    Kind.ARRAY: Array,
    Kind.SOLENOID: Solenoid,
}
FIXED: dict[Kind, dict[str, Any]] = {Kind.ARM: {"motion": Motion.POSE}, Kind.MAXWELL: {"is_opposed": True}}

"""First rig files and plans of the set-ups that laboratories build most: pairs, a cage, an array of sensors, a solenoid with a mapper.

In each of them the middle is the origin of the room, and what moves is a stage whose base is not known to a millimetre.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any

from estimator.errors import InvalidInput
from estimator.rig.first import RELATIVE_SD, thickness_at_most
from estimator.rig_files.starter import (
    Earth,
    Motion,
    Moved,
    Starter,
    check_answer,
    check_name,
    filled,
    starter_plan_text,
)

MARGIN_MM = 12.0  # of a place that was measured with a ruler, four times its standard deviation
# Distance of two square loops over their side, where the field is flattest in the middle.
SQUARE_HELMHOLTZ = 0.5445
MAXWELL = math.sqrt(3.0)  # distance of two opposed loops over their radius, where the gradient is flattest


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
class Wound:
    """Answers that all of these set-ups share, in the units of rig files.

    Attributes:
        name: Of the rig.
        wire_radius_mm: Half the distance of neighbouring turns.
        axial_loops, radial_loops: Turns along the axis, and layers, of each coil.
        reach_mm: How far the stage goes to each side.
        noise_uT: Scatter of one component of one reading.
        largest_A: Largest current of each coil.
        earth: Whether readings contain the Earth's field.
    """

    name: str = "my rig"
    wire_radius_mm: float = 0.5
    axial_loops: float = 10.0
    radial_loops: float = 10.0
    reach_mm: float = 40.0
    noise_uT: float = 20.0
    largest_A: float = 3.0
    earth: Earth = Earth.INCLUDED

    def __post_init__(self) -> None:
        for field in fields(self):
            check_answer(field.name, getattr(self, field.name))

    @property
    def thickness_mm(self) -> float:
        """Thickness of the layers, at most."""
        return thickness_at_most(self.wire_radius_mm, self.radial_loops)

    @property
    def length_mm(self) -> float:
        """Length of the winding."""
        return 2.0 * self.wire_radius_mm * self.axial_loops

    def check_bore(self, key: str, inner_mm: float) -> None:
        """Refuse a stage whose sensor would come into a winding.

        Raises:
            InvalidInput: The corners of its way are not inside the bore of this half width.
        """
        room_mm = (inner_mm - MARGIN_MM) / math.sqrt(2.0)
        if room_mm <= 0.0:
            raise InvalidInput(
                f"{key} must leave a bore in which a sensor can be moved, beside layers of {self.thickness_mm:.4g} mm; "
                f"received {getattr(self, key):g}"
            )
        if self.reach_mm > room_mm:
            raise InvalidInput(
                f"reach_mm must be at most {room_mm:.4g}, so that the sensor stays inside the bore; received {self.reach_mm:g}"
            )

    def filled(
        self,
        words: str,
        coils: Mapping[str, Mapping[str, Any]],
        settings: Sequence[Mapping[str, float]],
        depth_mm: float,
    ) -> tuple[str, str]:
        """Rig file and plan.

        Args:
            words: What the coils are there for.
            coils: Of each its place along the axis (`face_mm`), the coil whose numbers it shares (`like`), and what else the template asks.
            settings: Currents of the coils; each is set with both signs at every pose.
            depth_mm: How far the stage goes along z to each side.
        """
        usual: dict[str, Any] = {"like": "", "side_mm": None, "frees_turns": False}
        both_signs = [
            {name: sign * A for name, A in each.items()} for each in settings for sign in (1.0, -1.0)
        ]
        return (
            filled(
                "wound_rig",
                s=self,
                words=words,
                coils={name: usual | dict(coil) for name, coil in coils.items()},
            ),
            filled("wound_plan", s=self, settings=both_signs, depth_mm=depth_mm),
        )


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
        words = (
            "Distance of the middles over the mean radius: 1.732, a Maxwell pair. Currents of opposite sign make a gradient."
            if self.is_opposed
            else "Distance of the middles over the mean radius: 1, a Helmholtz pair. Equal currents make a flat field."
        )
        coils: dict[str, dict[str, Any]] = {
            "coil1": {"face_mm": half_mm + 0.5 * self.length_mm},
            "coil2": {"face_mm": -half_mm + 0.5 * self.length_mm, "like": "coil1"},
        }
        both = {"coil1": self.largest_A, "coil2": -self.largest_A if self.is_opposed else self.largest_A}
        settings = [{"coil1": self.largest_A}, {"coil2": self.largest_A}, both]
        return self.filled(words, coils, settings, self.reach_mm)


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
        coils: dict[str, dict[str, Any]] = {}
        for axis, turn in (("x", "ry_deg: 90"), ("y", "rx_deg: -90"), ("z", "")):
            side_mm = self._side_mm(axis)
            half_mm = 0.5 * SQUARE_HELMHOLTZ * (side_mm + self.thickness_mm)
            of_both = {"side_mm": side_mm, "axis": axis, "turn": turn}
            for number, middle_mm, like in ((1, half_mm, ""), (2, -half_mm, f"{axis}1")):
                face_mm = middle_mm + 0.5 * self.length_mm
                coils[f"{axis}{number}"] = {**of_both, "face_mm": face_mm, "like": like}
        words = "Two windings of a pair in series have the same current in both of their columns, such as x1_current_A and x2_current_A."
        pairs = [{f"{axis}1": self.largest_A, f"{axis}2": self.largest_A} for axis in "xyz"]
        return self.filled(words, coils, pairs, self.reach_mm)


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
        words = "The axis of the solenoid is z."
        coils: dict[str, dict[str, Any]] = {"coil1": {"face_mm": 0.5 * self.length_mm, "frees_turns": True}}
        settings = [{"coil1": self.largest_A}, {"coil1": 0.5 * self.largest_A}]
        return self.filled(words, coils, settings, 0.75 * self.length_mm)


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
        n_side = math.ceil(math.sqrt(self.n_sensors))
        middle_mm = 0.5 * (n_side - 1) * self.spacing_mm
        places_mm = {
            f"s{n + 1}": tuple(k * self.spacing_mm - middle_mm for k in (n % n_side, n // n_side))
            for n in range(self.n_sensors)
        }
        return filled("starter_rig", s=self, places_mm=places_mm), starter_plan_text(self)


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
    return set_up.texts()


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

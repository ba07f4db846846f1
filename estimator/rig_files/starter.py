"""The first rig file and plan of a new set-up: one coil, one sensor, one mover, with comments that say what each number is.

Other set-ups (`set_ups`) are made of the same parts (`parts.yaml.j2`). Every free number has a prior as wide as a ruler and a maker's note
leave it; the comments say when to free another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from estimator.errors import InvalidInput, quoted
from estimator.rig import first
from estimator.rig.first import RELATIVE_SD, thickness_at_most
from estimator.rig_files.read import NAME, SCHEMA_VERSION

PLACE_SD_MM, TILT_SD_DEG = 1e3 * first.PLACE_SD_M, math.degrees(first.TILT_SD_RAD)
NEAREST_SDS = 4.0  # of place and tilt, between a sensor and the front face of the winding
TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    undefined=StrictUndefined,
    keep_trailing_newline=True,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.filters["g"] = "{:g}".format
TEMPLATES.globals |= {
    "SCHEMA_VERSION": SCHEMA_VERSION,
    "RELATIVE_SD": RELATIVE_SD,
    "PLACE_SD_MM": PLACE_SD_MM,
    "TILT_SD_DEG": TILT_SD_DEG,
    "MOUNT_SD_DEG": math.degrees(first.MOUNT_SD_RAD),
    "FACE_SD_MM": 1.0,  # of the distance of two windings on one frame, or of two sensors
    "FRAME_SD_DEG": 0.2,  # between the axes of two frames of a cage, set to a millimetre or two
    "ROOM_SD_T": first.ROOM_SD_T,
    "ZERO_SD_T": first.ZERO_SD_T,
    "N_POSES": 40,
    "N_JUDGED": 12,
}


class Moved(StrEnum):
    """What the mover carries; the other body stands still and is the origin of the room."""

    COIL = "coil"
    SENSOR = "sensor"


class Motion(StrEnum):
    """What the mover reports. Joint angles need the arm's place in the room, which nobody can guess."""

    DISPLACEMENT = "displacement"
    POSE = "pose"


class Earth(StrEnum):
    """What readings hold of the Earth's field."""

    INCLUDED = "included"
    SUBTRACTED = "subtracted"


@dataclass(frozen=True)
class Starter:
    """What is asked of the user, in the units of rig files.

    Attributes:
        name: Of the rig.
        motion: What the mover reports.
        moved: What it carries.
        radius_mm: Outer radius of the winding.
        wire_radius_mm: Half the distance of neighbouring turns.
        axial_loops, radial_loops: Turns along the axis, and layers.
        distance_mm: Along the axis, from the front face of the winding, where its frame sits, to the sensor where they are nearest.
        reach_mm: How far the mover goes to each side, and away.
        noise_uT: Scatter of one component of one reading.
        largest_A: Largest current.
        earth: Whether readings contain the Earth's field.
    """

    name: str = "my rig"
    motion: Motion = Motion.DISPLACEMENT
    moved: Moved = Moved.COIL
    radius_mm: float = 48.0
    wire_radius_mm: float = 0.46
    axial_loops: float = 45.0
    radial_loops: float = 22.0
    distance_mm: float = 40.0
    reach_mm: float = 40.0
    noise_uT: float = 20.0
    largest_A: float = 3.0
    earth: Earth = Earth.INCLUDED

    def __post_init__(self) -> None:
        for field in fields(self):
            check_answer(field.name, getattr(self, field.name))
        thickness_mm = thickness_at_most(self.wire_radius_mm, self.radial_loops)
        if thickness_mm >= self.radius_mm * (1.0 - 2.0 * RELATIVE_SD):
            rule = f"must exceed {thickness_mm / (1.0 - 2.0 * RELATIVE_SD):.4g}, the thickness of its layers and some room"
            raise InvalidInput(f"radius_mm {rule}; received {self.radius_mm:g}")
        if self.distance_mm < self.nearest_mm:
            rule = f"from the front face of the coil must be at least {self.nearest_mm:.4g}, so that no sensor comes into the winding"
            raise InvalidInput(f"distance_mm {rule}; received {self.distance_mm:g}")

    @property
    def nearest_mm(self) -> float:
        """How far the front face may be off: in place, and at its rim by a tilt."""
        rim_sd_mm = self.radius_mm * math.radians(TILT_SD_DEG)
        return NEAREST_SDS * math.hypot(PLACE_SD_MM, rim_sd_mm)

    def texts(self) -> tuple[str, str]:
        """Rig file and plan, with comments."""
        return starter_rig_text(self), starter_plan_text(self)


def filled(template: str, **values: Any) -> str:
    """A template of this folder with the answers as `s` and other values."""
    return TEMPLATES.get_template(f"{template}.yaml.j2").render(**values)


def starter_rig_text(starter: Starter) -> str:
    """The rig file, with comments."""
    return filled("starter_rig", s=starter, places_mm={})


def starter_plan_text(starter: Starter) -> str:
    """The plan, with comments."""
    side = -1.0 if starter.moved is Moved.COIL else 1.0
    start_mm = starter.distance_mm if starter.motion is Motion.POSE else 0.0
    # + 0.0: no minus sign before a zero.
    near_mm, far_mm = sorted((side * start_mm + 0.0, side * (start_mm + starter.reach_mm)))
    return filled("starter_plan", s=starter, near_mm=near_mm, far_mm=far_mm)


def check_answer(key: str, value: object) -> None:
    """Refuse an answer that no set-up can have, whatever the others are.

    Raises:
        InvalidInput: A length, a field or a current is not positive, or there is no whole turn.
    Examples:
        >>> check_answer("radial_loops", 0.0)
        Traceback (most recent call last):
        estimator.errors.InvalidInput: radial_loops must be at least 1 and below 10000; received 0
    """
    if key == "name":
        check_name(str(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    if key.endswith("_loops") and not 1.0 <= value < 1e4:
        raise InvalidInput(f"{key} must be at least 1 and below 10000; received {value:g}")
    if not 0.0 < value < 1e6:
        raise InvalidInput(f"{key} must be > 0 and below 1000000; received {value:g}")


def check_name(name: str) -> str:
    """A name that stands in YAML without quotes.

    Raises:
        InvalidInput: It has other characters.
    """
    if not all(NAME.fullmatch(word) for word in name.split()) or not name.strip():
        raise InvalidInput(f"name must consist of letters, digits, _, - and blanks; received {quoted(name)}")
    return " ".join(name.split())

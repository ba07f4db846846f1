"""The first rig file and plan of a new set-up: one coil, one sensor, one mover, with comments that say what each number is.

Other set-ups (`set_ups`) are made of the same parts. Every free number has a prior as wide as a ruler and a maker's note leave it; the
comments say when to free another.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import StrEnum

from estimator.errors import InvalidInput, quoted
from estimator.rig.first import (
    MOUNT_SD_RAD,
    PLACE_SD_M,
    RELATIVE_SD,
    ROOM_SD_T,
    TILT_SD_RAD,
    ZERO_SD_T,
    thickness_at_most,
)
from estimator.rig_files.read import NAME, SCHEMA_VERSION

PLACE_SD_MM, TILT_SD_DEG, MOUNT_SD_DEG = (
    1e3 * PLACE_SD_M,
    math.degrees(TILT_SD_RAD),
    math.degrees(MOUNT_SD_RAD),
)
NEAREST_SDS = 4.0  # of place and tilt, between a sensor and the front face of the winding
N_POSES, N_JUDGED = 40, 12


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


def starter_rig_text(starter: Starter) -> str:
    """The rig file, with comments."""
    s = starter
    is_coil_moved = s.moved is Moved.COIL
    still = "    # It stands still and is the origin of the room: every other place counts from here.\n"
    face = "    # Its frame sits on the axis, on the front face of the winding, with z pointing out of the coil.\n"
    coil = _moved_pose(s, "coil", -s.distance_mm) if is_coil_moved else f"{still}    world_from_coil: {{}}\n"
    sensor = (
        f"{still}    world_from_sensor: {{}}\n" if is_coil_moved else _moved_pose(s, "sensor", s.distance_mm)
    )
    return f"""\
{head(s.name)}
movers:                      # robots and stages; readings have six columns of each
  arm1:
{_motion_lines(s)}
coils:
  coil1:
{"    carried_by: arm1          # leave this out for a coil that stands still" + chr(10) if is_coil_moved else ""}\
    # Outer radius, over the insulation; a length, must be given. Free it unless you measured it far better than you need it.
    radius_mm: {normal(s.radius_mm, RELATIVE_SD * s.radius_mm)}
    # Half the distance of neighbouring turns, insulation included; a length. Free it: windings are never quite tight.
    wire_radius_mm: {normal(s.wire_radius_mm, RELATIVE_SD * s.wire_radius_mm)}
    # Turns along the axis, and layers; pure numbers, must be given. Write plain numbers if you counted them.
    axial_loops: {normal(s.axial_loops, max(1.0, RELATIVE_SD * s.axial_loops), lower=1.0)}
    radial_loops: {normal(s.radial_loops, max(0.5, RELATIVE_SD * s.radial_loops), lower=1.0)}
    # axial_pitch_mm, radial_pitch_mm: distance of turns and of layers; where left out, twice the wire radius.
    # current_gain: delivered over commanded current, 1 where left out. Free it only as narrowly as your ammeter is good:
    #   more current looks like more turns, and like more gain of the sensor below.
{face}{coil}
sensors:
  hall:
{"" if is_coil_moved else "    carried_by: arm1          # leave this out for a sensor that stands still" + chr(10)}\
{SENSOR_COMMENT}
    noise_uT: {noise(s.noise_uT)}
{GAIN}
{sensor}
{effects(("hall",), s.earth)}"""


SENSOR_COMMENT = (
    "    # Scatter of one component of one reading; a field, must be given. Free it unless you measured it."
)
GAIN = """\
    # Shown over true field, 1 where left out: a probe is good to a per cent, unless it was calibrated better.
    gain: {prior: {normal: {mean: 1, sd: 0.01}}}"""


def head(name: str) -> str:
    """The first lines of a rig file: what one is, and its name."""
    return f"""\
# A rig file says what is known of a set-up before any reading is looked at. 'coilcal schema rig' prints all keys that it may have.
#
# A key ends in its unit: lengths in m, cm, mm or um, angles in rad, mrad or deg, fields in T, mT, uT, nT or G.
# A plain number is exact, and no fit moves it:        radius_mm: 48
# A number with a prior is free, and a fit finds it:   radius_mm: {{prior: {{normal: {{mean: 48, sd: 3}}}}}}
# "sd" is how far off the number may well be; "lower" and "upper" may be added as bounds.
schema_version: {SCHEMA_VERSION}
name: "{name}"
"""


def effects(sensors: Sequence[str], earth: Earth) -> str:
    """The last lines of a rig file: what is there besides coils and sensors.

    Args:
        sensors: Their names.
        earth: Whether readings contain the Earth's field.
    """
    field = (
        f"  # The Earth's field is 25 to 65 uT. Narrow the priors to what you know of it.\n  background_field[room]: {_three(ROOM_SD_T)}\n"
        if earth is Earth.INCLUDED
        else "  # The Earth's field was subtracted from the readings.\n"
    )
    zeros = "".join(
        f"  sensor_offset[{name}]: {_three(ZERO_SD_T)}   # what the sensor shows in no field\n"
        for name in sensors
    )
    return f"""\
effects:                     # what is there besides, one entry cause[place] each; 'coilcal explain' lists all causes
{field}{zeros}\
  # Others that you know of, or that 'coilcal diagnose' finds, such as axis_gain[{sensors[0]}]: {{x: 0.01, y: 0, z: 0}}
#
# devices: how to reach the instruments, for 'coilcal acquire'; 'coilcal rig-simulator' writes an example.
"""


def noise(noise_uT: float) -> str:
    """The scatter of a reading, with its prior."""
    return f"{{prior: {{log_normal: {{median: {noise_uT:g}, relative_sd: 0.5}}}}}}"


def starter_plan_text(starter: Starter) -> str:
    """The plan, with comments."""
    s = starter
    side = -1.0 if s.moved is Moved.COIL else 1.0
    start = s.distance_mm if s.motion is Motion.POSE else 0.0
    # + 0.0: no minus sign before a zero.
    near, far = sorted((side * start + 0.0, side * (start + s.reach_mm)))
    span = f"{{from: {-s.reach_mm:g}, to: {s.reach_mm:g}}}"
    inner = f"{{from: {-0.8 * s.reach_mm:g}, to: {0.8 * s.reach_mm:g}}}"
    depth, middle = near + 0.1 * (far - near), far - 0.1 * (far - near)
    return f"""\
# A plan says which poses to visit with which currents: 'coilcal simulate' makes readings from it, 'coilcal acquire' measures it.
schema_version: 1
name: "first plan of {s.name}"
poses:
  calibration:               # what a fit sees
    scattered: {N_POSES}            # poses that fill the spans evenly; leave it out for a grid, and give each span a count
    arm1:                    # what is left out stays at 0; angles rx_deg, ry_deg, rz_deg likewise
      x_mm: {span}
      y_mm: {span}
      z_mm: {{from: {near:g}, to: {far:g}}}
  validation:                # kept out of every fit, to judge it
    scattered: {N_JUDGED}
    arm1:
      x_mm: {inner}
      y_mm: {inner}
      z_mm: {{from: {depth:g}, to: {middle:g}}}
# Largest current of each coil in ampere. Each pose is read without current, and at half and at the whole of it with both signs:
# that tells the coil from the room and from the sensor's zero. Or list settings yourself: currents_A: [{{coil1: 3}}, {{}}]
largest_A: {{coil1: {s.largest_A:g}}}
settle_s: 1                  # time from one reading to the next in seconds, 1 where left out
# order: mixed (where left out), random or raster; mixed shows drifts.
# repeats: visits of every pose, 1 where left out.
"""


def _motion_lines(s: Starter) -> str:
    if s.motion is Motion.DISPLACEMENT:
        return """\
    # "displacement": columns say how far it went since a reference position. Others: "pose" (position and rotation vector),
    # "UR3", "UR5e" and others (joint angles).
    motion: displacement
    # Axes of the displacements: of what is carried ("end_effector", where left out), or "base" with base_from_flange0 {rx_deg, ...}.
    # displacement_frame: end_effector
"""
    return f"""\
    # "pose": columns are position and rotation vector of the flange in the base. Others: "displacement" (since a reference position),
    # "UR3", "UR5e" and others (joint angles).
    motion: pose
    world_from_base:         # where the base stands in the room; 0 where left out. Free it: nobody knows it to a millimetre.
{place(6, "xyz", (0.0, 0.0, 0.0))}"""


def _moved_pose(s: Starter, kind: str, z_mm: float) -> str:
    """Pose of the body that the mover carries."""
    if s.motion is Motion.POSE:
        return f"""\
    # How it is mounted on the flange: x, y, z, rotation vector rx, ry, rz, then small turns tilt_x, tilt_y, spin; 0 where left out.
    # Its place is not free here, for that of the base is, and only their sum shows.
    flange_from_{kind}:
{tilts(TILT_SD_DEG, kind == "sensor")}"""
    return f"""\
    # Where it is at zero displacement: x, y, z, rotation vector rx, ry, rz, then small turns tilt_x, tilt_y, spin; 0 where left out.
    # Free the places and tilts of one body only. Never free this spin: a coil is round.
    world_from_{kind}0:
{place(6, "xyz", (0.0, 0.0, z_mm))}{tilts(TILT_SD_DEG)}\
    # How it is turned on what carries it, against the axes of the displacements.
    flange_from_{kind}:
{tilts(MOUNT_SD_DEG, kind == "sensor")}"""


def place(indent: int, axes: str, values_mm: tuple[float, ...]) -> str:
    """Places with a prior, as lines of a pose."""
    lines = (f"{axis}_mm: {normal(value, PLACE_SD_MM)}" for axis, value in zip(axes, values_mm, strict=True))
    return "".join(f"{' ' * indent}{line}\n" for line in lines)


def tilts(sd_deg: float, spins: bool = False) -> str:
    """Small turns with a prior, as lines of a pose."""
    angles = ("tilt_x", "tilt_y", *(["spin"] if spins else []))
    return "".join(f"      {angle}_deg: {normal(0.0, sd_deg)}\n" for angle in angles)


def _three(sd_T: float) -> str:
    """Components in T, of which nothing is known but their size."""
    sd = f"{sd_T * 1e6:g}e-6".replace("e", ".0e")
    return "{" + ", ".join(f"{axis}_T: {{prior: {{normal: {{mean: 0, sd: {sd}}}}}}}" for axis in "xyz") + "}"


def normal(mean: float, sd: float, lower: float | None = None) -> str:
    """A number with a normal prior."""
    bound = "" if lower is None else f", lower: {lower:g}"
    return f"{{prior: {{normal: {{mean: {mean:g}, sd: {sd:.3g}{bound}}}}}}}"


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

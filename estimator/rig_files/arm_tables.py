"""Kinematics of one arm in a rig file: `denavit_hartenberg` or `urdf` of any arm, `factory_corrections` of one of Universal Robots."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from estimator.errors import InvalidInput
from estimator.rig.arms import ARMS, N_JOINTS, ArmEnds, DenavitHartenberg
from estimator.rig.bodies import CARTESIAN, MotionKind
from estimator.rig.charged_box import Triple
from estimator.rig_files.arm_files import arm_from_urdf, corrections_from_ros
from estimator.units import LARGEST
from estimator.yaml_section import Section

Table = TypeVar("Table")  # of an arm, with its ends or without
TABLE, CORRECTIONS, URDF = "denavit_hartenberg", "factory_corrections", "urdf"
FILE = "file"  # of `ur_calibration`
ENDS = ("base_from_first", "last_from_flange")
COLUMNS = (("theta", "angle"), ("a", "length"), ("d", "length"), ("alpha", "angle"))


def key_of_table(motion: MotionKind) -> str | None:
    """Key of what a mover of this kind may say of its own kinematics."""
    if motion is MotionKind.JOINTS:
        return TABLE
    return CORRECTIONS if str(motion) in ARMS else None


def read_own_table(section: Section, motion: MotionKind) -> tuple[DenavitHartenberg | None, ArmEnds | None]:
    """Read a mover's own kinematics; columns that are left out are zero.

    A URDF is read here and now; the rig keeps its table.

    Raises:
        InvalidInput: An arm of another maker has no table, or a column does not hold a number for each of its six joints.
    """
    key = key_of_table(motion)
    if key is None:
        return None, None
    if motion is MotionKind.JOINTS and URDF in section:
        if key in section:
            section.refuse(URDF, f"must not be given beside {TABLE}", "both")
        return _from_urdf(section)
    if key not in section:
        if motion is MotionKind.JOINTS:
            words = f"joints needs the table {TABLE} {{theta, a, d, alpha}}, or {URDF} {{file, base, flange}}"
            section.refuse("motion", words, "none")
        return None, None
    below = section.section(key)
    if motion is not MotionKind.JOINTS and FILE in below:
        return _from_ros(section, below, motion), None
    columns = [_column(below, quantity, dimension) for quantity, dimension in COLUMNS]
    has_ends = motion is MotionKind.JOINTS and bool([end for end in ENDS if end in below])
    ends = ArmEnds(*(_end(below.section(end)) for end in ENDS)) if has_ends else None
    below.finish()
    return DenavitHartenberg(*columns), ends


def _end(section: Section) -> tuple[float, ...]:
    entries = (section.quantity(quantity, dimension) for quantity, dimension in CARTESIAN)
    numbers = tuple(0.0 if entry is None else entry[1] for entry in entries)
    section.finish()
    return numbers


def _from_urdf(section: Section) -> tuple[DenavitHartenberg, ArmEnds]:
    below = section.section(URDF)
    file, base, flange = (str(below.required(key)) for key in ("file", "base", "flange"))
    below.finish()
    return _from_file(section, URDF, file, "its URDF", lambda path: arm_from_urdf(path, base, flange))


def _from_ros(section: Section, below: Section, motion: MotionKind) -> DenavitHartenberg:
    file = str(below.required(FILE))
    below.finish()
    return _from_file(
        section, CORRECTIONS, file, "its file of links", lambda path: corrections_from_ros(path, str(motion))
    )


def _from_file(section: Section, key: str, file: str, words: str, read: Callable[[Path], Table]) -> Table:
    """What stands in a file beside the rig file; a fault of that file is told with the place of the key."""
    if section.folder is None:
        rule = f"must stand in a rig file on disk, beside {words}; a session or calibration holds the table"
        section.refuse(key, rule, file)
    try:
        return read(section.folder / file)
    except InvalidInput as error:
        raise InvalidInput.at(section.place(key), f"{section.path_of(key)}: {error}") from None


def _column(section: Section, quantity: str, dimension: str) -> tuple[float, ...]:
    key_and_unit = section.key_with_unit(quantity, dimension)
    if key_and_unit is None:
        return (0.0,) * N_JOINTS
    key, unit = key_and_unit
    values = section.value(key)
    is_list = isinstance(values, list) and len(values) == N_JOINTS
    if not is_list or not all(is_number(value) for value in values):
        rule = f"must be a list of {N_JOINTS} numbers within {-LARGEST:g} and {LARGEST:g}, one for each joint"
        section.refuse(key, rule, repr(values))
    return tuple(float(value) * unit.to_si for value in values)


def read_points(section: Section, quantity: str, rule: str, fewest: int) -> tuple[str, list[Triple]]:
    """The key of a list of points and the points in metres, as many as a rule asks for at least; none where they are left out."""
    key_and_unit = section.key_with_unit(quantity, "length")
    if key_and_unit is None:
        return quantity, []
    key, unit = key_and_unit
    points = section.value(key)
    if not (isinstance(points, list) and len(points) >= fewest and all(map(_is_point, points))):
        section.refuse(key, rule, repr(points))
    return key, [(float(x) * unit.to_si, float(y) * unit.to_si, float(z) * unit.to_si) for x, y, z in points]


def is_number(value: object) -> bool:
    """Whether an entry of a list is a number that a rig file may hold."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _is_point(point: object) -> bool:
    return isinstance(point, list) and len(point) == 3 and all(map(is_number, point))

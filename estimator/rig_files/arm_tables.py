"""Kinematics of one arm in a rig file: `denavit_hartenberg` of an arm of any maker, `factory_corrections` of one of Universal Robots."""

from __future__ import annotations

from estimator.rig.arms import ARMS, DenavitHartenberg
from estimator.rig.rig import MotionKind
from estimator.yaml_section import LARGEST, Section

TABLE, CORRECTIONS = "denavit_hartenberg", "factory_corrections"
COLUMNS = (("theta", "angle"), ("a", "length"), ("d", "length"), ("alpha", "angle"))
N_JOINTS = 6


def key_of_table(motion: MotionKind) -> str | None:
    """Key of what a mover of this kind may say of its own kinematics."""
    if motion is MotionKind.JOINTS:
        return TABLE
    return CORRECTIONS if str(motion) in ARMS else None


def read_own_table(section: Section, motion: MotionKind) -> DenavitHartenberg | None:
    """Read a mover's own kinematics; columns that are left out are zero.

    Raises:
        InvalidInput: An arm of another maker has no table, or a column does not hold a number for each of its six joints.
    """
    key = key_of_table(motion)
    if key is None:
        return None
    if key not in section:
        if motion is MotionKind.JOINTS:
            section.refuse("motion", f"joints needs the table {TABLE} {{theta, a, d, alpha}}", "none")
        return None
    below = section.section(key)
    columns = [_column(below, quantity, dimension) for quantity, dimension in COLUMNS]
    below.finish()
    return DenavitHartenberg(*columns)


def _column(section: Section, quantity: str, dimension: str) -> tuple[float, ...]:
    found = section.key_with_unit(quantity, dimension)
    if found is None:
        return (0.0,) * N_JOINTS
    key, unit = found
    values = section.value(key)
    is_list = isinstance(values, list) and len(values) == N_JOINTS
    if not is_list or not all(_is_number(value) for value in values):
        rule = f"must be a list of {N_JOINTS} numbers within {-LARGEST:g} and {LARGEST:g}, one for each joint"
        section.refuse(key, rule, repr(values))
    return tuple(float(value) * unit.to_si for value in values)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST

"""What a heading means in the names of a rig: `Hall Bx/G` is `Bx` in gauss where one sensor is there."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig
from estimator.store.importers.forms.layout import strip_brackets
from estimator.store.importers.forms.units import FileUnit, split_file_unit, unit_named


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


TIME_WORDS = _words("t time timestamp stamp clock elapsed datetime zeit uhrzeit temps tiempo tid")
FIELD_WORDS = _words(
    "b h field bfield mag magnetic magnet magnetometer magneticfield flux density induction hall feld magnetfeld champ gauss tesla"
)
CURRENT_WORDS = _words(
    "i current curr amps amp ampere strom courant corriente iset imeas iout psu supply coil"
)
PLACE_WORDS = _words("pos position place location loc coord coordinate stage displacement d p tcp")
TURN_WORDS = _words("rot rotation rotvec r orientation")
TEMPERATURE_WORDS = _words("temp temperature temperatur")
SENSOR_WORDS = _words("sensor probe")
# A column with one of these says something about a quantity, not its value.
BESIDE_WORDS = _words(
    "std sd stdev stddev dev sigma err error noise rms var variance uncertainty unc min max delta gradient limit target setpoint raw adc "
    "counts range rate speed velocity status flag norm abs total expected theory predicted model fit residual rem background id"
)
MEAN_WORDS = _words("mean avg average measured meas value")  # say nothing that matters
AXES = frozenset("xyz")
LONGEST_NAME = 200  # letters of a heading that may mean something
BRACKETED = re.compile(r"^(?P<what>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")
DIVIDED = re.compile(r"^(?P<what>.+?)\s*(?:/|,|;|:|\bin\b|\s)\s*(?P<unit>[^\s/]+(?:/m)?)\s*$")


@dataclass(frozen=True)
class Target:
    """A column that a rig takes.

    Attributes:
        quantity: Its name without unit; fields of one of several sensors begin with its name.
        role: Time, current, field, place, turn, joint, temperature, or the name itself.
        dimension: Of its unit; None for words.
        axis: x, y or z, or the number of a joint.
        body: Coil, sensor or mover.
    """

    quantity: str
    role: str
    dimension: str | None
    axis: str = ""
    body: str = ""


@dataclass(frozen=True)
class Heading:
    """A heading taken apart.

    Attributes:
        text: As it stands in the file.
        what: The quantity in it.
        unit_text: What may be a unit; empty where there is none.
        unit: The unit, where it is known.
    """

    text: str
    what: str
    unit_text: str
    unit: FileUnit | None


def targets_of(rig: Rig) -> list[Target]:
    """The columns that a rig takes, those of several sensors beside each other too."""
    targets = [Target("t", "time", "time")]
    targets += [Target(f"{coil.name}_current", "current", "current", body=coil.name) for coil in rig.coils]
    for mover in rig.movers:
        is_pose = mover.motion in (MotionKind.POSE, MotionKind.DISPLACEMENT)
        for number, column in enumerate(mover.columns):
            quantity, unit = split_file_unit(column)
            dimension = "length" if unit is None else unit.dimension
            role = "joint" if not is_pose else "place" if dimension == "length" else "turn"
            axis = "xyz"[number % 3] if is_pose else str(number)
            targets.append(Target(quantity, role, dimension, axis, mover.name))
    targets += [Target(f"B{axis}", "field", "field", axis) for axis in "xyz"]
    if len(rig.sensors) > 1:
        targets += [
            Target(f"{sensor.name}_B{axis}", "field", "field", axis, sensor.name)
            for sensor in rig.sensors
            for axis in "xyz"
        ]
    for body in (*rig.coils, *rig.sensors):
        targets.append(Target(f"{body.name}_temperature", "temperature", "temperature", body=body.name))
    return targets + [
        Target(name, name, None) for name in ("sensor", "set", "repeat", "segment", "recorded_at")
    ]


def heading_of(text: str, unit_below: str = "") -> Heading:
    """A heading taken apart.

    Args:
        text: As it stands in the file.
        unit_below: Of a line of units; empty where there is none.
    Examples:
        >>> [(h.what, h.unit_text) for h in map(heading_of, ("Bx [mT]", "B_x(Gauss)", "Hall Bx/G", "Bx_uT", "Time", "pos (x)"))]
        [('Bx', 'mT'), ('B_x', 'Gauss'), ('Hall Bx', 'G'), ('Bx', 'uT'), ('Time', ''), ('pos x', '')]
    """
    name = text.strip()
    if len(name) > LONGEST_NAME:
        return Heading(text, "", "", None)
    if name.lower() == "x_value":  # the time of LabVIEW's measurement files
        return Heading(text, "time", "s", unit_named("s"))
    if unit_below and unit_named(strip_brackets(unit_below)) is not None:
        below = strip_brackets(unit_below)
        return Heading(text, name, below, unit_named(below))
    if match := BRACKETED.match(name):
        inside = match["unit"].strip()
        unit = unit_named(inside)
        if unit is None and (not match["what"] or inside.lower() in AXES or len(inside.split()) > 2):
            return Heading(text, f"{match['what']} {inside}".strip(), "", None)
        return Heading(text, match["what"], inside, unit)
    quantity, unit = split_file_unit(name)
    if unit is not None:
        return Heading(text, quantity, unit.symbol, unit)
    if (match := DIVIDED.match(name)) and (unit := unit_named(match["unit"])) is not None:
        return Heading(text, match["what"], match["unit"], unit)
    stem, _, suffix = name.rpartition("_")  # such as Bx_Gauss
    if stem and len(suffix) > 1 and (unit := unit_named(suffix)) is not None:
        return Heading(text, stem, suffix, unit)
    return Heading(text, name, "", None)


def words_of(what: str) -> list[str]:
    """The words of a heading in lower case, letters of a component apart.

    Examples:
        >>> words_of("HallBx"), words_of("B_x"), words_of("stage_rx"), words_of("coil1 current")
        (['hall', 'b', 'x'], ['b', 'x'], ['stage', 'r', 'x'], ['coil', '1', 'current'])
    """
    words: list[str] = []
    for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^\W\d_]+", what):
        lower = part.lower()
        if (
            len(lower) in (2, 4)
            and lower[-1] in AXES
            and lower[:-1] in {"b", "h", "r", "p", "d", "pos", "mag", "rot"}
        ):
            words += [lower[:-1], lower[-1]]
        elif len(lower) == 4 and lower[0] in AXES and lower[1:] in {"pos", "rot", "mag"}:
            words += [lower[1:], lower[0]]
        else:
            words.append(lower)
    return words


def candidates(heading: Heading, targets: Sequence[Target]) -> list[tuple[Target, int]]:
    """Columns of a rig that a heading may mean, with the number of its words that this leaves unexplained.

    Examples:
        >>> targets = [Target("Bx", "field", "field", "x"), Target("stage_x", "place", "length", "x", "stage")]
        >>> for text in ("X [mm]", "X [mT]", "Probe field X", "Bx std"):
        ...     print([found.quantity for found, _ in candidates(heading_of(text), targets)])
        ['stage_x']
        ['Bx']
        ['Bx']
        []
    """
    exact = [target for target in targets if target.quantity == heading.what]
    if exact and (heading.unit is None or heading.unit.dimension == exact[0].dimension):
        return [(exact[0], 0)]
    words = words_of(heading.what)
    if BESIDE_WORDS & set(words):
        return []
    fits = [
        (target, extra) for target in targets if (extra := _unexplained(heading, words, target)) is not None
    ]
    named = [(target, extra) for target, extra in fits if target.body and _names(heading.what, target.body)]
    fits = named or fits
    least = min((extra for _, extra in fits), default=0)
    return [(target, extra) for target, extra in fits if extra == least]


def _unexplained(heading: Heading, words: Sequence[str], target: Target) -> int | None:
    """How many words of a heading a column leaves unexplained; None where it is another quantity."""
    if heading.unit is not None and heading.unit.dimension != target.dimension:
        return None
    if target.role == "field" and target.body and not _is_of(heading.what, words, target.body):
        return None
    role_words = ROLES.get(target.role, frozenset((target.role,)))
    has_role = any(word in role_words for word in words)
    left = [word for word in words if word not in role_words and word not in MEAN_WORDS]
    if target.body:
        own = words_of(target.body)
        left = [word for word in left if word not in own]
    if target.axis:
        if target.axis not in left:
            return None
        left.remove(target.axis)
        if AXES & set(left):
            return None
    is_bare_place = target.role == "place" and bool(target.axis) and heading.unit is None and not left
    says_what = (
        has_role or (heading.unit is not None and target.role not in {"turn", "joint"}) or is_bare_place
    )
    if target.role == "turn" and heading.unit is not None and not has_role:
        says_what = True  # an angle about an axis
    if not says_what:
        return None
    if target.role == "place" and has_role and not target.axis:
        return None
    if (
        target.role in {"field", "place"}
        and set(words) & (TURN_WORDS - {"orientation"})
        and heading.unit is None
    ):
        return None
    return None if target.role == target.quantity and left else len(left)


def _is_of(what: str, words: Sequence[str], body: str) -> bool:
    """Whether a heading names a sensor, or has its number."""
    numbers = {word for word in words_of(body) if word.isdecimal()}
    return _names(what, body) or bool(numbers & set(words))


def _names(what: str, body: str) -> bool:
    """Whether a heading names a body of the rig."""

    def letters(text: str) -> str:
        return re.sub(r"[^a-z0-9]", "", text.lower())

    return letters(body) in letters(what)


ROLES: Mapping[str, frozenset[str]] = {
    "time": TIME_WORDS,
    "field": FIELD_WORDS,
    "current": CURRENT_WORDS,
    "place": PLACE_WORDS,
    "turn": TURN_WORDS,
    "joint": frozenset(("q", "joint")),
    "temperature": TEMPERATURE_WORDS,
    "sensor": SENSOR_WORDS,
}

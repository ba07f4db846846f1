"""Goals of a measurement: how well a field or some parameters shall be known, as numbers and as a user writes them.

A goal is turned into rows: derivatives of its numbers in the coordinates of a fit, over their targets. A number whose row has a standard
deviation of 1 has a 90 % interval of just the wanted half-width.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from estimator.derivatives import value_and_jacobian
from estimator.errors import InvalidInput, closest, quoted
from estimator.given_files import MOST_TABLE_BYTES, read_given_text
from estimator.model.room_field import RoomField
from estimator.planning.causes import visible_half_widths
from estimator.readings.halton import halton
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch
from estimator.units import UNITS, split_unit


@dataclass(frozen=True)
class FieldGoal:
    """Half-width of the 90 % interval of each component of a coil's field in a workspace, each coil alone at its largest current.

    It is the field that the current adds: what is there without current, such as the Earth's field, does not count.

    Attributes:
        half_width: In tesla, or as a share of the root mean square of the field in the workspace.
        is_share: Which of both.
        is_worst: Whether the least known component at any point counts; else the root mean square of all.
        points_m: Points of the workspace in the world frame, with all movers at zero.
        largest_A: Current of each coil.
        names: Parameters that its numbers are of; none.
    """

    text: str
    half_width: float
    is_share: bool
    is_worst: bool
    points_m: Float[Tensor, "point 3"]
    largest_A: Mapping[str, float]
    names: tuple[str, ...] = ()

    def rows(
        self, coordinates: Coordinates, at: Float[Tensor, "draw all"]
    ) -> Float[Tensor, "draw number all"]:
        """Rows of each coil, point and component, at each draw.

        Args:
            coordinates: Of the rig that is fitted.
            at: Where the derivatives are taken, a row each.
        """
        rig = coordinates.rig
        room = RoomField(rig, coordinates.values(coordinates.start()), self.points_m)
        if bool(room.is_inside.any()):
            raise InvalidInput(
                f"workspace must lie outside the windings; {int(room.is_inside.sum())} of its {len(self.points_m)} points "
                f"do not (goal {self.text!r})"
            )
        each_A = torch.diag(at.new_tensor([self.largest_A[coil.name] for coil in rig.coils]))
        alone_A = each_A[each_A.any(-1)]
        current_A = torch.cat((alone_A, torch.zeros_like(each_A[:1])))[
            :, None
        ]  # the windings are summed once

        def added_T(values: Mapping[str, Tensor]) -> Tensor:
            field_T = room.field_T(values, current_A)
            return field_T[:-1] - field_T[-1]

        field_T, slopes = _slopes(added_T, coordinates, at)  # coil, draw, point, component
        share_T = field_T.square().sum(-1).mean(-1).sqrt()[..., None, None, None]
        rows = (slopes / share_T if self.is_share else slopes).flatten(2, 3)
        return rows.movedim(0, 1).flatten(1, 2) * (HALF_WIDTH_90 / self.half_width)


@dataclass(frozen=True)
class ParametersGoal:
    """Half-width of the 90 % interval of each of some free parameters; sizes of causes are such, too.

    Attributes:
        half_widths: By name, in the parameter's SI unit.
    """

    text: str
    half_widths: Mapping[str, float]
    is_worst: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that its numbers are of."""
        return tuple(self.half_widths)

    def rows(
        self, coordinates: Coordinates, at: Float[Tensor, "draw all"]
    ) -> Float[Tensor, "draw number all"]:
        """A row of each parameter, at each draw.

        Args:
            coordinates: Of the rig that is fitted.
            at: Where the derivatives are taken, a row each.
        """

        def wanted(values: Mapping[str, Tensor]) -> Tensor:
            return torch.stack([values[n] / w for n, w in self.half_widths.items()], dim=-1)

        return _slopes(wanted, coordinates, at)[1] * HALF_WIDTH_90


Goal: TypeAlias = FieldGoal | ParametersGoal


def _slopes(
    function: Callable[[Mapping[str, Tensor]], Tensor], coordinates: Coordinates, at: Tensor
) -> tuple[Tensor, Tensor]:
    """Values of a function at each draw, and their derivatives in the coordinates: all draws take the same step."""
    return value_and_jacobian(lambda step: function(coordinates.values(at + step)), torch.zeros_like(at[0]))


# Points that fill a workspace evenly, beside its corners; the mean over them is known to a few per cent
N_POINTS = 64
MOST_POINTS = 2000  # of a workspace that is given as a list
EXAMPLES = (
    "'field 0.2 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25', 'field 5 uT worst in ball r_mm=30 z_mm=10', "
    "'field 0.2 % in points places.csv', 'parameters coil1.radius_m 0.05 mm coil1.axial_loops 0.5' or 'causes axis_gain[hall].x=0.01'"
)


def goal_of(text: str, rig: Rig, largest_A: Mapping[str, float]) -> Goal:
    """Read a goal.

    Args:
        text: Such as `field 0.2 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25`.
        rig: Whose field or parameters it is about.
        largest_A: Current of each coil, at which the field shall be known.
    Raises:
        InvalidInput: It is no goal; the sentence shows what is one.

    Examples:
        >>> from estimator import load_rig
        >>> rig = load_rig("configs/paper_simulation.yaml")
        >>> goal_of("parameters coil1.radius_m 0.05 mm", rig, {"coil1": 3.0}).half_widths
        {'coil1.radius_m': 5e-05}
        >>> len(goal_of("field 0.2 % in ball r_mm=20", rig, {"coil1": 3.0}).points_m)
        70
    """
    kind, *words = text.split()
    if kind == "field" and "in" in words[:4]:
        width, place = words[: words.index("in")], words[words.index("in") + 1 :]
        is_worst = width[-1:] == ["worst"]
        half_width, is_share = _width(width[:-1] if is_worst else width, "field", text)
        return FieldGoal(text, half_width, is_share, is_worst, _workspace(place, text), largest_A)
    if kind == "parameters" and len(words) > 1:
        return ParametersGoal(text, _half_widths(words, rig, text))
    if kind == "causes" and words:
        return ParametersGoal(text, visible_half_widths(words, rig))
    raise _refused("begin with 'field NUMBER UNIT in', 'parameters NAME NUMBER' or 'causes NAME'", text)


def reads_file(text: str) -> bool:
    """Whether reading a goal would read a file.

    Examples:
        >>> reads_file("field 0.2 % in points places.csv"), reads_file("field 0.2 % in ball r_mm=20")
        (True, False)
    """
    kind, *words = text.split() or [""]
    return kind == "field" and "points" in words


def _refused(rule: str, text: str) -> InvalidInput:
    return InvalidInput(f"a goal must {rule}, such as {EXAMPLES}; received {quoted(text)}")


def _number(word: str, text: str) -> float:
    try:
        number = float(word)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise _refused("have finite numbers where numbers belong", text)
    return number


def _width(words: Sequence[str], dimension: str, text: str) -> tuple[float, bool]:
    """A half-width in SI, or as a share where it is in per cent."""
    number = _number(words[0], text) if words else 0.0
    symbol = words[1] if len(words) == 2 else ""
    unit = UNITS.get(symbol)
    is_known = symbol == "%" or (dimension == "1" and not words[1:]) or (unit and unit.dimension == dimension)
    if number <= 0.0 or len(words) > 2 or not is_known:
        known = ", ".join(u.symbol for u in UNITS.values() if u.dimension == dimension)
        raise _refused(f"have a half-width > 0 in % or in {known or 'the unit 1'}", text)
    return number * (0.01 if symbol == "%" else unit.to_si if unit else 1.0), symbol == "%"


def _half_widths(words: Sequence[str], rig: Rig, text: str) -> dict[str, float]:
    """Names, each followed by a number and, where it has one, a unit."""
    free = {parameter.name: parameter for parameter in rig.free}
    starts = [i for i, word in enumerate(words) if "." in word and not word[0].isdigit()]
    widths: dict[str, float] = {}
    for first, last in zip(starts, [*starts[1:], len(words)], strict=True):
        name = words[first]
        if name not in free or name.endswith(".noise_T"):
            raise _refused(f"name parameters that a fit may change{closest(name, list(free))}", text)
        dimension = next((u.dimension for u in UNITS.values() if u.symbol == free[name].unit), "1")
        width, is_share = _width(words[first + 1 : last], dimension, text)
        widths[name] = width * abs(rig.nominal_values()[name]) if is_share else width
    if not widths or starts[0] > 0 or not all(widths.values()):
        raise _refused("name parameters, each with a half-width > 0", text)
    return widths


def _workspace(words: Sequence[str], text: str) -> Float[Tensor, "point 3"]:
    """Points of a box, a ball or a list."""
    kind, *rest = words or [""]
    if kind == "points" and len(rest) == 1:
        return torch.from_numpy(_listed(Path(rest[0]), text))
    if kind not in ("box", "ball"):
        raise _refused("state a workspace: box, ball or points", text)
    spans = dict.fromkeys("xyzr", (0.0, 0.0))
    for word in rest:
        key, _, span = word.partition("=")
        name, unit = split_unit(key)
        ends = [_number(part, text) for part in span.split(":")]
        if unit is None or unit.dimension != "length" or name not in spans or len(ends) > 2:
            raise _refused("state a workspace with lengths, as x_mm=-50:50", text)
        spans[name] = (ends[0] * unit.to_si, ends[-1] * unit.to_si)
    low, high = np.array([spans[axis] for axis in "xyz"]).T
    radius_m = spans["r"][0]
    if (radius_m > 0.0) is not (kind == "ball"):
        raise _refused("state r for a ball, and for a ball alone", text)
    unit_cube = np.concatenate((halton(3, N_POINTS + 1)[1:], np.indices((2, 2, 2)).reshape(3, 8).T))
    if kind == "box":
        return torch.from_numpy(low + unit_cube * (high - low))
    return torch.from_numpy(0.5 * (low + high) + radius_m * _ball(unit_cube[:N_POINTS]))


def _ball(unit_cube: np.ndarray) -> np.ndarray:
    """Points of the unit cube, taken to the unit ball evenly, and its six ends along the axes."""
    radius, height = unit_cube[:, 0] ** (1.0 / 3.0), 2.0 * unit_cube[:, 1] - 1.0
    angle, flat = 2.0 * np.pi * unit_cube[:, 2], np.sqrt(1.0 - height**2)
    inside = radius[:, None] * np.stack((flat * np.cos(angle), flat * np.sin(angle), height), axis=1)
    return np.concatenate((inside, np.eye(3), -np.eye(3)))


def _listed(path: Path, text: str) -> np.ndarray:
    """Points of a CSV file with the columns x, y and z, each with a unit of length."""
    header, *lines = csv.reader(read_given_text(path, MOST_TABLE_BYTES).splitlines())
    units = {name: (i, unit) for i, (name, unit) in enumerate(map(split_unit, header)) if unit}
    try:
        columns = [
            [float(line[i]) * unit.to_si for line in lines if line]
            for i, unit in map(units.__getitem__, "xyz")
        ]
    except (KeyError, ValueError, IndexError) as error:
        raise _refused(f"name a CSV file with columns x_mm, y_mm and z_mm ({path})", text) from error
    points_m = np.array(columns).T
    if not 0 < len(points_m) <= MOST_POINTS or not np.isfinite(points_m).all():
        raise _refused(f"name a CSV file with 1 to {MOST_POINTS} finite points ({path})", text)
    return points_m

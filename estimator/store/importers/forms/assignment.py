"""Which column of a file is which quantity of a rig: by a recipe where one names it, else by heading, unit and cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from estimator.errors import Faults, InvalidInput, Place, closest, quoted
from estimator.rig.rig import Rig
from estimator.store.importers.forms.cells import DATE_CELL, is_clock
from estimator.store.importers.forms.headings import (
    Target,
    candidates,
    heading_of,
    targets_of,
)
from estimator.store.importers.forms.recipe import CLOCK, DATE, NOTHING, Recipe
from estimator.store.importers.forms.units import SYMBOLS, FileUnit, split_file_unit
from estimator.units import UNITS

MOST_LISTED = 6  # columns in a sentence
UNKNOWN_UNIT = FileUnit("?", "?", 0.0)  # of a column that was refused for it
MOSTLY = 0.6  # of the cells that are not empty
# Seconds since 1970 as programs count them, by the size of the number.
EPOCHS = ((1e9, 4e9, "s"), (1e12, 4e12, "ms"), (1e15, 4e15, "us"), (1e18, 4e18, "ns"))


@dataclass(frozen=True)
class Assigned:
    """A column that is read.

    Attributes:
        column: Its number, from 0.
        header: As it stands in the file.
        quantity: What it is; `clock` or `date` for times that are no numbers.
        unit: Of its numbers; None for words, clocks and dates.
    """

    column: int
    header: str
    quantity: str
    unit: FileUnit | None

    @property
    def name(self) -> str:
        """The name that a recipe gives it."""
        return self.quantity if self.unit is None else f"{self.quantity}_{self.unit.symbol}"


@dataclass(frozen=True)
class Assignment:
    """Which columns are read as what.

    Attributes:
        assigned: Columns that are read.
        left_out: Headers of the others.
    """

    assigned: tuple[Assigned, ...]
    left_out: tuple[str, ...]


class _Assigner:
    """Assigns the columns of one file."""

    def __init__(
        self,
        header: Sequence[str],
        units: Sequence[str],
        rig: Rig,
        recipe: Recipe,
        place: Place,
        faults: Faults,
    ) -> None:
        units_below = [*units, *[""] * len(header)]
        self.headings = [heading_of(*pair) for pair in zip(header, units_below, strict=False)]
        self.targets = targets_of(rig)
        self.rig, self.recipe, self.place, self.faults = rig, recipe, place, faults
        self.assigned: dict[int, Assigned] = {}
        self.left_out: set[int] = set()
        self.unsure: dict[int, list[str]] = {}
        self.refused: set[str] = set()

    def text(self, index: int) -> str:
        """The header of a column."""
        return self.headings[index].text.strip()

    def refuse(self, words: str, index: int | None = None) -> None:
        """Note a fault of the header, or of one of its columns."""
        place = replace(self.place, column=None if index is None else index + 1)
        self.faults.note(InvalidInput(f"{words} ({place.file}, line {place.line})", place))

    def give(self) -> None:
        """Assign what the recipe names."""
        texts = [heading.text.strip() for heading in self.headings]
        for header, name in self.recipe.columns.items():
            if texts.count(header) != 1:
                origin = f" of {self.recipe.origin}" if self.recipe.origin else ""
                many = "be there once" if header in texts else "be in the file"
                known = ", ".join(map(quoted, texts[: 2 * MOST_LISTED]))
                self.refuse(f"column {quoted(header)}{origin} must {many}; its columns are {known}")
                continue
            index = texts.index(header)
            if name == NOTHING:
                self.left_out.add(index)
            elif (named := self._named(index, name)) is not None:
                self.assigned[index] = named
        quantities = [each.quantity for each in self.assigned.values()]
        for quantity in dict.fromkeys(quantities):
            if quantities.count(quantity) > 1:
                self.refuse(f"{quantity} must be one column; the recipe names {quantities.count(quantity)}")

    def _named(self, index: int, name: str) -> Assigned | None:
        header = self.text(index)
        if name in {CLOCK, DATE}:
            return Assigned(index, header, name, None)
        by_quantity = {target.quantity: target for target in self.targets}
        if name in by_quantity and by_quantity[name].dimension is None:
            return Assigned(index, header, name, None)
        quantity, unit = split_file_unit(name)
        target = by_quantity.get(quantity)
        if target is None:
            hint = closest(quantity, by_quantity)
            self.refuse(
                f"column {quoted(header)} must be one that the rig knows; received {quoted(name)}{hint}",
                index,
            )
            return None
        if unit is None or unit.dimension != target.dimension:
            self.refuse(
                f"column {quoted(header)} must have a unit of {target.dimension} at the end of its name "
                f"({_symbols(target.dimension)}); received {quoted(name)}",
                index,
            )
            return None
        return Assigned(index, header, quantity, unit)

    def find_clock(self, cells: Sequence[Sequence[str]]) -> None:
        """Assign columns whose cells are times of day or dates."""
        taken = {each.quantity for each in self.assigned.values()}
        if "t" in taken:
            return
        for index in self.free():
            own = [row[index].strip() for row in cells if index < len(row) and row[index].strip()]
            header = self.text(index)
            if header == "recorded_at":
                continue
            for kind, is_its in ((CLOCK, is_clock), (DATE, DATE_CELL.match)):
                n_fits = sum(bool(is_its(cell)) for cell in own)
                if kind not in taken and own and n_fits > MOSTLY * len(own):
                    self.assigned[index] = Assigned(index, header, kind, None)
                    taken.add(kind)
                    break
        if CLOCK not in taken:
            self.assigned = {i: each for i, each in self.assigned.items() if each.quantity != DATE}

    def free(self) -> list[int]:
        """Columns that nothing was said of."""
        return [i for i in range(len(self.headings)) if i not in self.assigned and i not in self.left_out]

    def guess(self, cells: Sequence[Sequence[str]]) -> None:
        """Assign columns by heading and unit."""
        claims: dict[str, list[tuple[int, int, Target]]] = {}
        taken = {each.quantity for each in self.assigned.values()}
        if CLOCK in taken:
            taken.add("t")
        for index in self.free():
            fits = [
                fit for fit in candidates(self.headings[index], self.targets) if fit[0].quantity not in taken
            ]
            if len(fits) == 1:
                claims.setdefault(fits[0][0].quantity, []).append((fits[0][1], index, fits[0][0]))
            elif fits:
                self.unsure[index] = [target.quantity for target, _ in fits]
        no_unit: list[tuple[int, Target]] = []
        for quantity, claiming in claims.items():
            least = min(extra for extra, _, _ in claiming)
            best = [claim for claim in claiming if claim[0] == least]
            if len(best) > 1:
                names = " and ".join(quoted(self.text(index)) for _, index, _ in best)
                self.refuse(
                    f"{quantity} must be one column; {names} may both be it: leave one out with "
                    f"--column '{self.text(best[1][1])}=-'",
                    best[1][1],
                )
            _, index, target = best[0]
            unit = self._unit(index, target, cells)
            if unit is UNKNOWN_UNIT:
                continue
            if unit is None and target.dimension is not None:
                no_unit.append((index, target))
            else:
                header = self.text(index)
                self.assigned[index] = Assigned(index, header, quantity, unit)
        if no_unit:
            self._refuse_without_unit(no_unit)

    def _unit(self, index: int, target: Target, cells: Sequence[Sequence[str]]) -> FileUnit | None:
        heading = self.headings[index]
        if target.dimension is None or heading.unit is not None:
            return heading.unit if target.dimension is not None else None
        if heading.unit_text:
            self.refused.add(target.quantity)
            self.refuse(
                f"the unit of column {quoted(self.text(index))} must be known; {quoted(heading.unit_text)} is none of "
                f"{_symbols(target.dimension)}: convert the column, or leave it out with --column '{self.text(index)}=-'",
                index,
            )
            return UNKNOWN_UNIT
        if target.quantity == "t":
            return _epoch_unit([row[index] for row in cells if index < len(row)])
        return None

    def _refuse_without_unit(self, no_unit: Sequence[tuple[int, Target]]) -> None:
        names = [self.text(index) for index, _ in no_unit]
        listed = ", ".join(map(quoted, names[:MOST_LISTED]))
        listed += f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
        target = no_unit[0][1]
        many = "columns" if len(names) > 1 else "column"
        self.refused |= {target.quantity for _, target in no_unit}
        self.refuse(
            f"{many} {listed} must have a unit; write it into the header, as {names[0]} [UNIT], or say it with "
            f"--column '{names[0]}={target.quantity}_UNIT'; units of {target.dimension} are {_symbols(target.dimension)}",
            no_unit[0][0],
        )


def _symbols(dimension: str | None) -> str:
    usual = [symbol for symbol, unit in UNITS.items() if unit.dimension == dimension]
    more = [symbol for symbol, unit in SYMBOLS.items() if unit.dimension == dimension and symbol not in usual]
    return ", ".join([*usual, *more])


def _epoch_unit(cells: Iterable[str]) -> FileUnit | None:
    """The unit of times that count from 1970, by their size; None where they are no such times."""
    try:
        values = [float(cell) for cell in cells if cell.strip()]
    except ValueError:
        return None
    for low, high, symbol in EPOCHS:
        if values and all(low < value < high for value in values):
            return SYMBOLS[symbol]
    return None


def assigned_columns(
    header: Sequence[str],
    units: Sequence[str],
    cells: Sequence[Sequence[str]],
    rig: Rig,
    recipe: Recipe,
    place: Place,
    faults: Faults,
) -> Assignment:
    """Which column is which quantity.

    Args:
        header: Names of the columns.
        units: Their units, where a line of its own has them.
        cells: Some rows.
        rig: Determines the quantities.
        recipe: What is known beforehand.
        place: Of the header, for messages.
        faults: What becomes of faults; columns at fault are left out.
    Raises:
        InvalidInput: A quantity is missing, may be one of several columns, or has no known unit; the sentence says what to do.
    """
    assigner = _Assigner(header, units, rig, recipe, place, faults)
    assigner.give()
    if not recipe.is_whole:
        assigner.find_clock(cells)
        assigner.guess(cells)
    assigned = tuple(assigner.assigned[index] for index in sorted(assigner.assigned))
    _check_missing(assigner, {each.quantity for each in assigned} | assigner.refused)
    left = [heading.text.strip() for i, heading in enumerate(assigner.headings) if i not in assigner.assigned]
    return Assignment(assigned, tuple(name for name in left if name))


def _check_missing(assigner: _Assigner, quantities: set[str]) -> None:
    """Refuse columns of which something that a rig needs is missing.

    Raises:
        InvalidInput: It is.
    """
    rig, quantities = assigner.rig, quantities | set(_quantities(assigner.recipe.constants))
    for target in assigner.targets:
        if target.quantity in quantities or target.role not in {"current", "place", "joint"}:
            continue
        may_be = [
            assigner.text(index) for index, names in assigner.unsure.items() if target.quantity in names
        ]
        symbol = next(symbol for symbol, unit in UNITS.items() if unit.dimension == target.dimension)
        name = f"{target.quantity}_{symbol}"
        if may_be:
            assigner.refuse(
                f"columns must include {name}; it may be {' or '.join(map(quoted, may_be[:MOST_LISTED]))}: say which with "
                f"--column '{may_be[0]}={target.quantity}_UNIT'"
            )
            continue
        value = "AMPERE" if target.role == "current" else "0"
        assigner.refuse(
            f"columns must include {name}; none is it: name one with --column 'HEADER={target.quantity}_UNIT', "
            f"or give it for all rows, such as --constant {name}={value}"
        )
    _check_rotations(assigner, quantities)
    fields = [
        target.quantity
        for target in assigner.targets
        if target.role == "field" and target.quantity in quantities
    ]
    if not fields:
        assigner.refuse(
            "columns must include a component of the field (Bx, By, Bz); none is one: name it with --column 'HEADER=Bz_UNIT'"
        )
    if (
        len(rig.sensors) > 1
        and "sensor" not in quantities
        and all(name in {"Bx", "By", "Bz"} for name in fields)
    ):
        example = f"{rig.sensors[0].name}_Bx_mT"
        assigner.refuse(
            f"the rig has {len(rig.sensors)} sensors, so columns must include sensor, or the fields of each, such as {example}: "
            f"name them with --column 'HEADER={example}'"
        )


def _check_rotations(assigner: _Assigner, quantities: set[str]) -> None:
    """Refuse some rotations of a mover without the others, and angles that are none of a rotation vector."""
    for mover in assigner.rig.movers:
        turns = [t.quantity for t in assigner.targets if t.role == "turn" and t.body == mover.name]
        missing = [name for name in turns if name not in quantities]
        if missing and len(missing) < len(turns):
            assigner.refuse(
                f"columns must include all rotations of {mover.name} or none; {missing[0]}_rad is missing: "
                f"give it for all rows, such as --constant {missing[0]}_rad=0"
            )
        angles = [
            assigner.text(index)
            for index in assigner.free()
            if (unit := assigner.headings[index].unit) is not None and unit.dimension == "angle"
        ]
        if missing and angles and not assigner.recipe.is_whole:
            assigner.refuse(
                f"angles must be the components of a rotation vector; {', '.join(map(quoted, angles[:MOST_LISTED]))} may be others: "
                f"say what they are with --column '{angles[0]}={turns[0]}_deg', or leave them out with --column '{angles[0]}=-'"
            )


def _quantities(constants: Mapping[str, float]) -> list[str]:
    return [split_file_unit(name)[0] for name in constants]

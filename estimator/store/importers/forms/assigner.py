"""Assigns columns of a file to quantities of a rig: by a recipe where one names them, else by heading, unit and cells."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from estimator.errors import Faults, InvalidInput, Place, closest, listed, quoted
from estimator.rig.rig import Rig
from estimator.store.importers.forms.cells import DATE_CELL, is_clock
from estimator.store.importers.forms.headings import Target, candidates, heading_of, targets_of
from estimator.store.importers.forms.recipe import CLOCK, DATE, NOTHING, Recipe, parts_of
from estimator.store.importers.forms.units import SYMBOLS, FileUnit, split_file_unit
from estimator.units import UNITS

MOST_LISTED = 6  # columns in a sentence
NEEDED = frozenset(("current", "place", "joint", "turn"))  # roles of which a rig takes every column
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


class Assigner:
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
        self.assigned: list[Assigned] = []
        self.left_out: set[int] = set()
        self.unsure: dict[int, list[str]] = {}
        self.refused: set[str] = set()

    def text(self, index: int) -> str:
        """The header of a column."""
        return self.headings[index].text.strip()

    def refuse(self, words: str, index: int | None = None) -> None:
        """Note a fault of the header, or of one of its columns."""
        place = replace(self.place, column=None if index is None else index + 1)
        self.faults.note(InvalidInput.at(place, words))

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
            else:  # windings in series have their current in one column
                named = [self._named(index, part) for part in parts_of(name)]
                self.assigned += [each for each in named if each is not None]
        quantities = [each.quantity for each in self.assigned]
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
        taken = {each.quantity for each in self.assigned}
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
                    self.assigned.append(Assigned(index, header, kind, None))
                    taken.add(kind)
                    break
        if CLOCK not in taken:
            self.assigned = [each for each in self.assigned if each.quantity != DATE]

    def free(self) -> list[int]:
        """Columns that nothing was said of."""
        taken = self.left_out | {each.column for each in self.assigned}
        return [i for i in range(len(self.headings)) if i not in taken]

    def guess(self, cells: Sequence[Sequence[str]]) -> None:
        """Assign columns by heading and unit."""
        claims: dict[str, list[tuple[int, int, Target]]] = {}
        taken = {each.quantity for each in self.assigned}
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
                self.assigned.append(Assigned(index, header, quantity, unit))
        if no_unit:
            self._refuse_without_unit(no_unit)

    def _unit(self, index: int, target: Target, cells: Sequence[Sequence[str]]) -> FileUnit | None:
        heading = self.headings[index]
        if target.dimension is None or heading.unit is not None:
            return heading.unit if target.dimension is not None else None
        if heading.unit_text:
            self.refused.add(target.quantity)
            cure = "convert the column"
            if target.role not in NEEDED:  # what is left out of these would count as zero
                cure += f", or leave it out with --column '{self.text(index)}=-'"
            self.refuse(
                f"the unit of column {quoted(self.text(index))} must be known; {quoted(heading.unit_text)} is none of "
                f"{_symbols(target.dimension)}: {cure}",
                index,
            )
            return UNKNOWN_UNIT
        if target.quantity == "t":
            return _epoch_unit([row[index] for row in cells if index < len(row)])
        return None

    def _refuse_without_unit(self, no_unit: Sequence[tuple[int, Target]]) -> None:
        names = [self.text(index) for index, _ in no_unit]
        shown = listed(map(quoted, names[:MOST_LISTED]), len(names))
        target = no_unit[0][1]
        many = "columns" if len(names) > 1 else "column"
        self.refused |= {target.quantity for _, target in no_unit}
        self.refuse(
            f"{many} {shown} must have a unit; write it into the header, as {names[0]} [UNIT], or say it with "
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

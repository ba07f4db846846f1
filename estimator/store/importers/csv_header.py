"""The first line of a readings CSV against the columns that a rig knows: what is wrong with it, and what to write instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from estimator.errors import Faults, InvalidInput, Place, closest, cut, nearest_name, quoted
from estimator.store.importers.table import Column, HeaderCell
from estimator.units import UNITS, Unit, split_unit

UNKNOWN = "is not known to the rig"
LONGEST_NAME = 200  # characters of a column that a rig may know
MOST_FURTHER = 1000  # columns of a file beside those that the rig knows


def csv_header(
    first_row: list[str], known: Mapping[str, Column], path: Path, faults: Faults
) -> dict[str, HeaderCell]:
    """Read where each quantity stands.

    Args:
        first_row: Cells of the header.
        known: Columns by quantity.
        path: The file, for messages.
        faults: What becomes of faults.
    """
    header: dict[str, HeaderCell] = {}
    are_names_told = False
    if len(first_row) > len(known) + MOST_FURTHER:
        words = f"a file must have at most {MOST_FURTHER} columns beside the {len(known)} that the rig knows"
        raise InvalidInput.at(Place(str(path), 1), f"{words}; received {len(first_row)}")
    for index, cell in enumerate(first_row):
        name = cell.strip()
        quantity, unit = (name, None) if name in known else split_unit(name)
        fault = _header_fault(name, quantity, unit, known, header)
        if fault is not None and UNKNOWN in fault and not are_names_told:  # one list serves all
            fault = f"{fault}; known are {', '.join(column.si_header for column in known.values())}"
            are_names_told = True
        if fault is None:
            header[quantity] = HeaderCell(index, name, unit.to_si if unit else 1.0)
        else:
            faults.note(InvalidInput.at(Place(str(path), 1, index + 1), fault))
    names = [cell.strip() for cell in first_row]
    if missing := _missing(header, known, [name for name in names if len(name) <= LONGEST_NAME]):
        words = f"columns must include {', '.join(missing)}; the header lacks them"
        faults.note(InvalidInput.at(Place(str(path), 1), words))
    return header


def _header_fault(
    name: str, quantity: str, unit: Unit | None, known: Mapping[str, Column], header: Mapping[str, HeaderCell]
) -> str | None:
    """What is wrong with a cell of the header, given those before it."""
    if len(name) > LONGEST_NAME:
        return f"column {quoted(name)} {UNKNOWN}"
    column = known.get(quantity)
    if column is None or (unit is not None and column.dimension is None):
        alike = [each for each in known.values() if unit is None or each.dimension in {None, unit.dimension}]
        headers = {each.quantity: each.si_header for each in alike}
        nearest = nearest_name(quantity, headers)
        hint = closest(name, headers.values()) if nearest is None else f"; the closest is {headers[nearest]}"
        if _is_other_unit(name, known):  # never answered with another unit: its numbers would be wrong
            hint = ""
        return f"column {quoted(name)} {UNKNOWN}{hint}"
    if column.dimension is not None and unit is None:
        symbols = ", ".join(each.symbol for each in UNITS.values() if each.dimension == column.dimension)
        return f"column {quoted(name)} lacks its unit: write {quantity}_UNIT, with one of {symbols}"
    if unit is not None and unit.dimension != column.dimension:
        return f"column {quantity!r} must be a {column.dimension}; received the unit {unit.symbol}"
    if quantity in header:
        return (
            f"column {quantity!r} must be given once; received {cut(header[quantity].text)} and {cut(name)}"
        )
    return None


def _is_other_unit(name: str, known: Mapping[str, Column]) -> bool:
    """Whether a name is one that the rig knows with a unit that coilcal does not know."""
    column = known.get(name.rpartition("_")[0])
    return column is not None and column.dimension is not None


def _missing(header: Mapping[str, HeaderCell], known: Mapping[str, Column], raw: Sequence[str]) -> list[str]:
    """Columns that the header lacks; one that is written, though wrongly, is no second mistake."""
    written = [split_unit(name)[0] for name in raw]
    groups = {known[quantity].group for quantity in header}
    quantities = {column.si_header: quantity for quantity, column in known.items()}
    unknown = [name for name in written if name not in known]
    intended = {
        nearest_name(name, known) or quantities.get(nearest_name(name, quantities) or "") for name in unknown
    }
    return [
        column.si_header
        for column in known.values()
        if column.is_required
        and column.quantity not in header
        and column.quantity not in written
        and column.quantity not in intended
        and (column.group is None or column.group in groups)
    ]

"""Which column of a file is which quantity of a rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimator.errors import Faults, Place
from estimator.rig.rig import Rig
from estimator.store.importers.forms.assigner import Assigned, Assigner
from estimator.store.importers.forms.missing import check_missing
from estimator.store.importers.forms.recipe import Recipe


@dataclass(frozen=True)
class Assignment:
    """Which columns are read as what.

    Attributes:
        assigned: Columns that are read.
        left_out: Headers of the others.
    """

    assigned: tuple[Assigned, ...]
    left_out: tuple[str, ...]


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
    assigner = Assigner(header, units, rig, recipe, place, faults)
    assigner.give()
    if not recipe.is_whole:
        assigner.find_clock(cells)
        assigner.guess(cells)
    assigned = tuple(assigner.assigned[index] for index in sorted(assigner.assigned))
    check_missing(assigner, {each.quantity for each in assigned} | assigner.refused)
    left = [heading.text.strip() for i, heading in enumerate(assigner.headings) if i not in assigner.assigned]
    return Assignment(assigned, tuple(name for name in left if name))

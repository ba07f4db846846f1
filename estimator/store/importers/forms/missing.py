"""What columns of a file lack for a rig, and what to write instead."""

from __future__ import annotations

import re

from estimator.errors import listed, quoted
from estimator.store.importers.forms.assigner import MOST_LISTED, Assigner
from estimator.store.importers.forms.headings import Target, words_of
from estimator.store.importers.forms.recipe import AND
from estimator.store.importers.forms.units import split_file_unit
from estimator.units import UNITS

ROUND = frozenset(
    ["r", "rho", "radius", "phi", "theta", "azimuth", "br", "brho", "bphi", "btheta"]
)  # headings of cylindrical coordinates
STRENGTH = frozenset(("abs", "absolute", "norm", "total", "magnitude", "modulus", "betrag"))
LONG = frozenset(("axis", "component", "direction"))  # headings that say which component a row holds


def check_missing(assigner: Assigner, quantities: set[str]) -> None:
    """Refuse columns of which something that a rig needs is missing.

    Raises:
        InvalidInput: It is.
    """
    rig, quantities = (
        assigner.rig,
        quantities | {split_file_unit(name)[0] for name in assigner.recipe.constants},
    )
    _check_axes(assigner, quantities)
    for target in assigner.targets:
        if target.quantity not in quantities and target.role in {"current", "place", "joint"}:
            _refuse_missing(assigner, target)
    _check_rotations(assigner, quantities)
    fields = [
        target.quantity
        for target in assigner.targets
        if target.role == "field" and target.quantity in quantities
    ]
    if not fields:
        _refuse_fields(assigner)
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


def _refuse_missing(assigner: Assigner, target: Target) -> None:
    symbol = next(symbol for symbol, unit in UNITS.items() if unit.dimension == target.dimension)
    name = f"{target.quantity}_{symbol}"
    may_be = [index for index, names in assigner.unsure.items() if target.quantity in names]
    if may_be:
        texts, unit = [assigner.text(index) for index in may_be], assigner.headings[may_be[0]].unit
        given = f"{target.quantity}_{'UNIT' if unit is None else unit.symbol}"
        words = f"it may be {' or '.join(map(quoted, texts[:MOST_LISTED]))}: say which with --column '{texts[0]}={given}'"
        if target.role == "current" and len(names := assigner.unsure[may_be[0]]) > 1:
            all_of_it = AND.join(given.replace(target.quantity, name) for name in names)
            words += f"; for coils in series --column '{texts[0]}={all_of_it}'"
    else:
        value = "AMPERE" if target.role == "current" else "0"
        words = (
            f"none is it: name one with --column 'HEADER={target.quantity}_UNIT', "
            f"or give it for all rows, such as --constant {name}={value}"
        )
        currents = [each for each in assigner.assigned if each.quantity.endswith("_current")]
        if target.role == "current" and currents:
            like = next((each for each in currents if each.quantity[0] == target.quantity[0]), currents[0])
            together = AND.join([like.name, like.name.replace(like.quantity, target.quantity)])
            words += f"; in series with another coil: --column '{like.header}={together}'"
    assigner.refuse(f"columns must include {name}; {words}")


def _refuse_fields(assigner: Assigner) -> None:
    """Say which columns may be a component of the field, or that a strength is none."""
    of_fields = {
        assigner.text(index): heading
        for index, heading in enumerate(assigner.headings)
        if index in assigner.free() and heading.unit is not None and heading.unit.dimension == "field"
    }
    strengths = [
        text
        for text, heading in of_fields.items()
        if "|" in heading.what or STRENGTH & set(words_of(heading.what))
    ]
    components = [text for text in of_fields if text not in strengths]
    if components:
        unit = of_fields[components[0]].unit
        assert unit is not None
        words = f"it may be {' or '.join(map(quoted, components[:MOST_LISTED]))}: say along which axis of the sensor with --column "
        words += f"'{components[0]}=Bz_{unit.symbol}'"
    elif strengths:
        words = f"{quoted(strengths[0])} is a strength without direction or sign: read components"
    else:
        words = "none is one: name it with --column 'HEADER=Bz_UNIT'"
    assigner.refuse(f"columns must include a component of the field (Bx, By, Bz); {words}")


def _check_axes(assigner: Assigner, quantities: set[str]) -> None:
    """Refuse cylindrical coordinates, and tables that have a row for each component, which no name of a column mends."""
    has_field = any(t.role == "field" and t.quantity in quantities for t in assigner.targets)
    has_place = all(t.role != "place" or t.quantity in quantities for t in assigner.targets)
    free = [(assigner.text(index), assigner.headings[index].what.lower()) for index in assigner.free()]
    round_ones = [text for text, what in free if re.sub(r"[\W_]", "", what) in ROUND]
    if len(round_ones) > 1 and not (has_field and has_place):
        shown = listed(map(quoted, round_ones[:MOST_LISTED]), len(round_ones))
        assigner.refuse(f"places and fields must be along x, y and z; {shown} look cylindrical: convert them")
    if not has_field and (axes := [text for text, what in free if what in LONG]):
        assigner.refuse(
            f"a row must hold all components of a reading; {quoted(axes[0])} names one in each row: "
            "write Bx, By and Bz into columns of one row, each with its unit"
        )


def _check_rotations(assigner: Assigner, quantities: set[str]) -> None:
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

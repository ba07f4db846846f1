"""What a header of another program most likely means, in the names of a rig: `X [mm]` is `arm1_x_mm` where one mover is there."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from estimator.units import UNITS, split_unit


class Known(NamedTuple):
    """A column that a rig knows: its dimension, None for a column without unit, and whether it has to be there."""

    dimension: str | None
    is_required: bool


# X [mm], X (mm), X / mm: what, then the unit.
WITH_UNIT = re.compile(r"^(?P<what>.+?)\s*(?:\[(?P<a>[^\]]+)\]|\((?P<b>[^)]+)\)|/\s*(?P<c>\S+))$")
SYMBOLS = {"µT": "uT", "μT": "uT", "µm": "um", "μm": "um", "°": "deg", "°C": "C", "sec": "s", "Gauss": "G"}
SHORT = {"time": "t", "i": "current", "temp": "temperature"}


def meant(header: str, known: Mapping[str, Known]) -> str | None:
    """The header to write instead, in the unit that was written; None where none or several columns may be meant.

    Examples:
        >>> known = {"t": Known("time", True), "arm1_x": Known("length", True), "Bx": Known("field", True)}
        >>> meant("X [mm]", known), meant("Bx (mT)", known), meant("time_s", known), meant("Time", known)
        ('arm1_x_mm', 'Bx_mT', 't_s', 't_s')
        >>> meant("humidity", known) is None
        True
    """
    match = WITH_UNIT.match(header)
    if match:
        what, symbol = match["what"], next(filter(None, match.group("a", "b", "c"))).strip()
        unit = UNITS.get(SYMBOLS.get(symbol, symbol))
        if unit is None:
            return None
    else:
        what, unit = split_unit(header)
    what = re.sub(r"[\s.-]+", "_", what.strip()).lower()
    what = SHORT.get(what, what)
    fits = [
        quantity
        for quantity, column in known.items()
        if (unit is None or column.dimension == unit.dimension)
        and (quantity.lower() == what or quantity.lower().endswith(f"_{what}"))
    ]
    best = [quantity for quantity in fits if known[quantity].is_required] or fits
    if len(best) != 1:
        return None
    dimension = known[best[0]].dimension
    unit = unit or next((each for each in UNITS.values() if each.dimension == dimension), None)
    return best[0] if unit is None else f"{best[0]}_{unit.symbol}"

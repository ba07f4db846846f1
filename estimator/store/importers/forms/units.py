"""Units as people write them in headers; docs/decisions/0002-libraries.md says why this is a table and no library."""

from __future__ import annotations

import re
from dataclasses import dataclass

from estimator.units import ICE_POINT_K, MU0_T_M_PER_A, UNITS

PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3}
SPOKEN = {"": "", "nano": "n", "micro": "u", "milli": "m", "centi": "c", "kilo": "k"}
# Symbol, dimension, size in SI, prefixes it is used with, and its names.
BASES: tuple[tuple[str, str, float, str, tuple[str, ...]], ...] = (
    ("T", "field", 1.0, "num", ("tesla",)),
    ("G", "field", 1e-4, "mk", ("gauss", "gs")),
    ("Oe", "field", 1e-4, "mk", ("oersted",)),
    ("A", "current", 1.0, "umk", ("amp", "ampere", "ampère")),
    ("m", "length", 1.0, "numc", ("meter", "metre")),
    ("s", "time", 1.0, "num", ("second", "sec")),
    ("rad", "angle", 1.0, "m", ("radian",)),
)
OTHERS: tuple[tuple[str, str, float, float, tuple[str, ...]], ...] = (
    ("A/m", "field", MU0_T_M_PER_A, 0.0, ()),
    ("kA/m", "field", 1e3 * MU0_T_M_PER_A, 0.0, ()),
    ("in", "length", 0.0254, 0.0, ("inch", "inches", '"')),
    ("min", "time", 60.0, 0.0, ("minute", "minutes")),
    ("h", "time", 3600.0, 0.0, ("hr", "hrs", "hour", "hours")),
    ("d", "time", 86400.0, 0.0, ("day", "days")),
    ("deg", "angle", UNITS["deg"].to_si, 0.0, ("degree", "degrees", "°")),
    ("C", "temperature", 1.0, 0.0, ("°c", "degc", "deg c", "celsius")),
    ("K", "temperature", 1.0, -ICE_POINT_K, ("kelvin",)),
    ("degF", "temperature", 5.0 / 9.0, -160.0 / 9.0, ("°f", "fahrenheit")),
)


@dataclass(frozen=True)
class FileUnit:
    """A unit of a column: `value * to_si + offset_si` is in SI.

    Attributes:
        symbol: As the name of a column ends.
        dimension: As in `estimator.units`.
        to_si, offset_si: To SI, and to degrees Celsius.
    """

    symbol: str
    dimension: str
    to_si: float
    offset_si: float = 0.0


def _tables() -> tuple[dict[str, FileUnit], dict[str, FileUnit]]:
    """Units by symbol, and by what else they are called, in lower case."""
    symbols: dict[str, FileUnit] = {}
    names: dict[str, FileUnit] = {}
    for symbol, dimension, size, prefixes, words in BASES:
        for spoken, prefix in SPOKEN.items():
            if prefix and prefix not in prefixes:
                continue
            unit = FileUnit(prefix + symbol, dimension, size * PREFIXES[prefix])
            symbols[unit.symbol] = unit
            for word in words:
                for name in (spoken + word, prefix + word):
                    names[name] = names[f"{name}s"] = unit
    for symbol, dimension, size, offset, other_words in OTHERS:
        symbols[symbol] = FileUnit(symbol, dimension, size, offset)
        names |= dict.fromkeys(other_words, symbols[symbol])
    known = {symbol: FileUnit(symbol, unit.dimension, unit.to_si) for symbol, unit in UNITS.items()}
    return symbols | known, names


SYMBOLS, NAMES = _tables()


def unit_named(text: str) -> FileUnit | None:
    """The unit that a header means; None where it is not known.

    Examples:
        >>> [unit_named(text).symbol for text in ("mT", "µT", "Gauss", "mG", "Amps", "MM", "°", "msec", "deg C", "kA/m")]
        ['mT', 'uT', 'G', 'mG', 'A', 'mm', 'deg', 'ms', 'C', 'kA/m']
        >>> unit_named("g"), unit_named("furlong"), unit_named("V")
        (None, None, None)
    """
    text = re.sub(r"\s+", " ", text.strip().replace("µ", "u").replace("μ", "u").rstrip("."))
    if text in SYMBOLS:
        return SYMBOLS[text]
    lower = text.lower()
    if lower in NAMES:
        return NAMES[lower]
    if len(text) == 1:  # g is no gauss, and t no tesla
        return None
    alike = [unit for symbol, unit in SYMBOLS.items() if symbol.lower() == lower]
    return alike[0] if len(alike) == 1 else None


def split_file_unit(name: str) -> tuple[str, FileUnit | None]:
    """Quantity and unit of a name such as `t_min`; the unit is None where the name carries none.

    Examples:
        >>> split_file_unit("t_min")
        ('t', FileUnit(symbol='min', dimension='time', to_si=60.0, offset_si=0.0))
    """
    quantity, _, suffix = name.rpartition("_")
    unit = SYMBOLS.get(suffix)
    return (quantity, unit) if unit is not None and quantity else (name, None)

"""Lengths of a rig file that no laboratory has, most likely by a wrong unit. They may be true, so they are told and not refused."""

from __future__ import annotations

from estimator.rig_files.numbers import Numbers
from estimator.units import UNITS, split_unit

# Smallest and largest, in m, of usual ones; a thousand times more or less of most is beyond. Of coils from those of a micromanipulator
# to those of a beam line; wires from a hair's to that of a busbar.
USUAL_M = {
    "radius": (1e-3, 2.0),
    "inner_side_x": (1e-3, 4.0),
    "inner_side_y": (1e-3, 4.0),
    "inner_corner_radius": (0.0, 2.0),
    "wire_radius": (1e-5, 0.02),
    "axial_pitch": (2e-5, 0.2),
    "radial_pitch": (2e-5, 0.2),
}
FARTHEST_M = 10.0  # of a body from the origin of the room, from its mount or from where it was


def unlikely_lengths(numbers: Numbers) -> list[str]:
    """Sentences on lengths beyond what rigs of laboratories have: which, what is usual, and the key that the number would suit."""
    told = []
    for name, (section, key) in numbers.origin.items():
        parameter = numbers.parameters[name]
        quantity = name.rpartition(".")[2].removesuffix("_m")
        low_m, high_m = USUAL_M.get(quantity, (0.0, FARTHEST_M))
        if parameter.unit != "m" or parameter.tie is not None or low_m <= abs(parameter.value) <= high_m:
            continue
        usual = (
            f"usual are {_words(low_m)} to {_words(high_m)}"
            if low_m
            else f"usual is at most {_words(high_m)}"
        )
        told.append(
            f"{section.path_of(key)}: {_words(parameter.value)} is unlikely, {usual}{_cure(key, parameter.value, low_m, high_m)} "
            f"({section.place(key)})."
        )
    return told


def _cure(key: str, value_m: float, low_m: float, high_m: float) -> str:
    """The key with which the same number would be usual; empty where it would be so in no unit."""
    stem, unit = split_unit(key)
    if unit is None:  # of a cause, whose keys are in SI
        return ""
    number = value_m / unit.to_si
    for symbol in ("mm", "m"):
        if low_m <= abs(number * UNITS[symbol].to_si) <= high_m:
            return f"; if {number:g} {symbol} is meant, write {stem}_{symbol}"
    return ""


def _words(length_m: float) -> str:
    """A length in metres, or in millimetres where it is small.

    Examples:
        >>> _words(50.0), _words(1e-5), _words(-0.05)
        ('50 m', '0.01 mm', '-50 mm')
    """
    return f"{length_m:g} m" if abs(length_m) >= 1.0 else f"{1e3 * length_m:g} mm"

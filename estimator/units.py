"""Constants and units: SI inside, the user's units only at the edges.

A key or column name carries its unit as suffix (``radius_mm``), which `split_unit` splits off. `MU0_T_M_PER_A` is the CODATA 2018
magnetic constant; it differs from 4 pi 1e-7 by 5e-10, far below any winding's tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass

MU0_T_M_PER_A = 1.25663706212e-6
ICE_POINT_K = 273.15
LARGEST = 1e12  # of any number that a user gives, in whatever unit; powers of larger ones overflow


@dataclass(frozen=True)
class Unit:
    """A unit of measurement: its dimension and the factor to SI."""

    symbol: str
    dimension: str
    to_si: float


UNITS: dict[str, Unit] = {
    unit.symbol: unit
    for unit in (
        Unit("m", "length", 1.0),
        Unit("cm", "length", 1e-2),
        Unit("mm", "length", 1e-3),
        Unit("um", "length", 1e-6),
        Unit("rad", "angle", 1.0),
        Unit("mrad", "angle", 1e-3),
        Unit("deg", "angle", 0.017453292519943295),
        Unit("A", "current", 1.0),
        Unit("mA", "current", 1e-3),
        Unit("T", "field", 1.0),
        Unit("mT", "field", 1e-3),
        Unit("uT", "field", 1e-6),
        Unit("nT", "field", 1e-9),
        Unit("G", "field", 1e-4),
        Unit("mG", "field", 1e-7),
        Unit("s", "time", 1.0),
        Unit("ms", "time", 1e-3),
        Unit("C", "temperature", 1.0),
    )
}

# Units of causes and results, by the suffix of a key.
DERIVED_UNITS = {
    "A_m2": Unit("A m2", "moment", 1.0),
    "m3": Unit("m3", "volume", 1.0),
    "cm3": Unit("cm3", "volume", 1e-6),
    "mm3": Unit("mm3", "volume", 1e-9),
    "h": Unit("h", "time", 3600.0),
}


def split_unit(key: str) -> tuple[str, Unit | None]:
    """Split a key into quantity and unit; the unit is None if the key carries none.

    Examples:
        >>> split_unit("wire_radius_mm")
        ('wire_radius', Unit(symbol='mm', dimension='length', to_si=0.001))
        >>> split_unit("axial_loops")
        ('axial_loops', None)
    """
    quantity, _, suffix = key.rpartition("_")
    unit = UNITS.get(suffix)
    return (quantity, unit) if unit and quantity else (key, None)


def split_quotient(key: str) -> tuple[str, Unit | None, str]:
    """Split a key whose unit may be derived, such as a quotient, into quantity, unit of the numerator and symbol of the denominator.

    Examples:
        >>> split_quotient("moment_x_A_m2")
        ('moment_x', Unit(symbol='A m2', dimension='moment', to_si=1.0), '')
        >>> split_quotient("drift_x_T_per_h")
        ('drift_x', Unit(symbol='T', dimension='field', to_si=1.0), 'h')
        >>> split_quotient("loss_per_A2"), split_quotient("axial_loops")
        (('loss', None, 'A2'), ('axial_loops', None, ''))
    """
    head, _, denominator = key.rpartition("_per_")
    for suffix, derived in DERIVED_UNITS.items():
        if not head and key.endswith(f"_{suffix}"):
            return key.removesuffix(f"_{suffix}"), derived, ""
    quantity, unit = split_unit(head or key)
    return quantity, unit, denominator if head else ""

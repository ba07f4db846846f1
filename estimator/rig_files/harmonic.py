"""Coils without a winding in rig files, both ways: degree and sphere, or a box with charges and multipoles; amplitudes with priors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from statistics import mode
from typing import Any

from estimator.rig.bodies import EquivalentSourceCoil, HarmonicCoil, Region, UnwoundCoil
from estimator.rig.charged_box import MOST_CHARGES, Triple, gap_m, n_charges
from estimator.rig.harmonic_terms import HIGHEST_DEGREE
from estimator.rig.parameters import Normal, Parameter
from estimator.rig_files.arm_tables import read_points
from estimator.rig_files.numbers import MOST_DIGITS, Numbers, read_number, read_scalar
from estimator.units import split_unit
from estimator.yaml_section import Section

HARMONIC = "harmonic"
EQUIVALENT_SOURCES = "equivalent_sources"
OF_THE_BOX = ("half_x", "half_y", "half_z", "margin", "spacing")
MULTIPOLES = "multipoles"
WIDTH, FALLOFF = "sd_T_per_A", "falloff"
UNIT = "T/A"


def read_harmonic(section: Section, coil: HarmonicCoil, numbers: Numbers) -> None:
    """Read the sphere of reference and the amplitudes of a coil.

    Args:
        section: Of the coil.
        coil: With its degree.
        numbers: Where they go.
    """
    read_scalar(section, coil.name, "reference_radius", "length", numbers, positive=True)
    radius = numbers.parameters[f"{coil.name}.reference_radius_m"]
    if radius.prior is not None or radius.tie is not None:
        key = numbers.origin[radius.name][1]
        section.refuse(key, "must be a plain number: amplitudes are given at that radius", "a prior or tie")
    read_amplitudes(section, coil, numbers)


def read_amplitudes(section: Section, coil: UnwoundCoil, numbers: Numbers) -> None:
    """Read the amplitudes of a coil.

    They have normal priors about zero, as wide as `sd_T_per_A` in degree 1 and `falloff` times narrower in each degree above; those that
    are listed by name have what is written there. Charges on a box have no degrees.

    Args:
        section: Of the coil.
        coil: Whose names they have.
        numbers: Where they go.
    """
    if "amplitudes" not in section:
        section.required("amplitudes")
    block = section.section("amplitudes")
    for key in block:  # another unit, or none
        if key != WIDTH and (key == "sd" or key.startswith("sd_")):
            block.refuse(key, f"must be written as {WIDTH}, in SI", repr(block.value(key)))
    width = block.number(WIDTH) if WIDTH in block else None
    if width is not None and width <= 0.0:
        block.refuse(WIDTH, "must be > 0", f"{width:g}")
    falloff = block.number(FALLOFF, 1.0) if coil.has_degrees else 1.0
    if not 0.0 < falloff <= 1.0:
        block.refuse(FALLOFF, "must be above 0 and at most 1", f"{falloff:g}")
    for degree, names in coil.amplitudes.items():
        for name in names:
            key = name.removeprefix(f"{coil.name}.")
            if key in block:
                _read_amplitude(block, key, name, numbers)
                continue
            if width is None:
                _refuse_misspelt(block, key)
                rule = f"must state the width of its priors, {WIDTH}, or list every amplitude"
                section.refuse("amplitudes", rule, f"neither {WIDTH} nor {key}")
            prior = Normal(0.0, prior_width(width, falloff, degree))
            numbers.parameters[name] = Parameter(name, UNIT, 0.0, prior)
    block.finish()


def read_region(section: Section) -> tuple[Region, int]:
    """Region and degree of a coil without a winding."""
    region = Region(section.choice("region", tuple(Region)))
    degree = section.number("degree")
    if not (degree.is_integer() and 1 <= degree <= HIGHEST_DEGREE):
        section.refuse("degree", f"must be a whole number from 1 to {HIGHEST_DEGREE}", f"{degree:g}")
    return region, int(degree)


def read_box(section: Section, name: str) -> EquivalentSourceCoil:
    """A coil with charges on a box, still without its amplitudes."""
    x_m, y_m, z_m, margin_m, spacing_m = (_length_m(section, quantity) for quantity in OF_THE_BOX)
    coil = EquivalentSourceCoil(name, None, (x_m, y_m, z_m), margin_m, spacing_m)
    n = n_charges(coil.intervals)
    if n > MOST_CHARGES:
        key_and_unit = section.key_with_unit("spacing", "length")
        assert key_and_unit is not None
        section.refuse(
            key_and_unit[0], f"must leave at most {MOST_CHARGES} charges on the box", f"{n} charges"
        )
    return replace(coil, multipoles_m=_read_multipoles(section, coil))


def _read_multipoles(section: Section, coil: EquivalentSourceCoil) -> tuple[Triple, ...]:
    """Places of multipoles beside the box, each of its own."""
    key, places_m = read_points(section, MULTIPOLES, "must be a list of places, each of three numbers", 0)
    for number, place_m in enumerate(places_m):
        given = section.value(key)[number]
        if gap_m(place_m, coil.half_m) <= 0.0:
            section.refuse(
                key, f"must lie outside the box that holds the readings of {coil.name}", repr(given)
            )
        if place_m in places_m[:number]:
            section.refuse(key, "must be places that differ", f"{given!r} twice")
    return tuple(places_m)


def _length_m(section: Section, quantity: str) -> float:
    key_and_unit = section.key_with_unit(quantity, "length")
    if key_and_unit is None:
        section.required(f"{quantity}_m")
    assert key_and_unit is not None
    key, unit = key_and_unit
    length_m = section.number(key) * unit.to_si
    if length_m <= 0.0:
        section.refuse(key, "must be > 0", f"{section.number(key):g}")
    return length_m


def prior_width(width: float, falloff: float, degree: int) -> float:
    """Standard deviation of the amplitudes of a degree.

    Examples:
        >>> prior_width(8e-3, 0.5, 3)
        0.002
    """
    return float(width * falloff ** (degree - 1))


def amplitude_section(
    coil: UnwoundCoil, parameters: Mapping[str, Parameter], entries: Mapping[str, Any]
) -> dict[str, Any]:
    """Amplitudes as the reader takes them: one width and its falloff, and by name what these do not say.

    Args:
        coil: Whose amplitudes.
        parameters: Of the rig.
        entries: By name of an amplitude, its entry in a rig file.
    """
    width, falloff = _widths(coil, parameters)
    written: dict[str, Any] = {} if width is None else {WIDTH: width}
    if width is not None and falloff != 1.0:
        written[FALLOFF] = falloff
    for degree, names in coil.amplitudes.items():
        for name in names:
            is_said = width is not None and repr(parameters[name]) == repr(
                Parameter(name, UNIT, 0.0, Normal(0.0, prior_width(width, falloff, degree)))
            )
            if not is_said:
                written[name.removeprefix(f"{coil.name}.")] = entries[name]
    return written


def _widths(coil: UnwoundCoil, parameters: Mapping[str, Parameter]) -> tuple[float | None, float]:
    """Width and falloff that say most widths of a coil to the last bit; None where no first degree has a prior about zero."""
    priors = {
        degree: [p.sd for name in names if isinstance(p := parameters[name].prior, Normal) and p.mean == 0.0]
        for degree, names in coil.amplitudes.items()
    }
    sds = {degree: mode(own) for degree, own in priors.items() if own}
    if 1 not in sds:
        return None, 1.0
    width, highest = sds[1], max(sds)
    if highest == 1 or sds[highest] > width:
        return width, 1.0
    ratio = (sds[highest] / width) ** (1.0 / (highest - 1))
    rounded = [float(f"{ratio:.{digits}g}") for digits in range(1, MOST_DIGITS + 1)]

    def n_said(falloff: float) -> int:
        return sum(repr(prior_width(width, falloff, degree)) == repr(sd) for degree, sd in sds.items())

    return width, max((f for f in rounded if 0.0 < f <= 1.0), key=n_said, default=1.0)


def _read_amplitude(block: Section, key: str, name: str, numbers: Numbers) -> None:
    read_number(block, key, name, UNIT, 1.0, numbers)
    prior = numbers.parameters[name].prior
    if prior is not None and not is_unbounded(prior):
        block.refuse(key, "must have a normal prior without bounds, or none", "another")


def is_unbounded(prior: object) -> bool:
    """Whether a prior is normal without bounds."""
    return isinstance(prior, Normal) and prior == Normal(prior.mean, prior.standard_deviation)


def _refuse_misspelt(block: Section, wanted: str) -> None:
    """An amplitude without its unit, or in another."""
    stem = wanted.removesuffix("_T_per_A")
    for key in block:
        if key != wanted and (key == stem or key.startswith(f"{stem}_") or split_unit(key)[0] == stem):
            block.refuse(key, f"must be written as {wanted}, in SI", repr(block.value(key)))

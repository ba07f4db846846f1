"""Numbers for people: display units, short names of parameters, and values with their standard deviations.

Reports, plots and commands share it. It loads no plotting library, so that a command that only prints starts quickly.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Num

from estimator.units import DERIVED_UNITS, UNITS, split_quotient

PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
EVEN = 0.3  # of log evidence, about 4 to 3
SHOWN_IN = {"m": "mm", "rad": "mrad", "T": "uT", "m3": "cm3", "h": "s"}
BALL = "cubed radius of a ball"  # what pieces of iron have in m3: of the ball that answers as they do, whose volume is 4 pi / 3 times that
PREFIXED = ("T", "m", "rad", "A", "A m2", "s")  # units, and numerators of units, that take a prefix
SUPERSCRIPTS = str.maketrans("23", "²³")


@dataclass(frozen=True)
class Display:
    """Display of a parameter: `words` name it, and values times `factor` are in `unit`."""

    words: str
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """Words and unit, for an axis."""
        return f"{self.words} ({self.unit})" if self.unit else self.words

    def with_sd(self, value: float, sd: float) -> str:
        """A value with its standard deviation, without the unit."""
        return with_sd(value * self.factor, sd * self.factor)

    def interval(self, ends: Sequence[float], sd: float) -> str:
        """Ends of an interval to the digits of a standard deviation, without the unit."""
        return " to ".join(to_digit_of(sd * self.factor, end * self.factor) for end in ends)


def displays(names: Sequence[str]) -> dict[str, Display]:
    """Short names and display units of parameters: lengths in mm, angles in mrad, fields in µT.

    A name is cut to its quantity if that is unique among the names. Pieces of iron are told by the ball that answers as they do.

    Examples:
        >>> displays(["coil1.radius_m", "coil1.world_from_coil.tilt_x_rad"])["coil1.radius_m"]
        Display(words='radius', unit='mm', factor=1000.0)
        >>> [s.label for s in displays(["coil1.axial_loops", "hall.noise_T", "probe.noise_T"]).values()]
        ['axial loops', 'hall noise (µT)', 'probe noise (µT)']
        >>> displays(["coil1.degree1_cos0_T_per_A"])["coil1.degree1_cos0_T_per_A"].label
        'degree1 cos0 (µT/A)'
        >>> displays(["iron_body[room].volume_m3"])["iron_body[room].volume_m3"].label
        'cubed radius of a ball (cm³)'
    """

    def candidates(name: str) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """Parts of a name, the shortest choice first."""
        words, unit, _ = split_quotient(name)
        parts = tuple(words.split("."))
        if unit and unit.symbol == "m3":
            parts = (*parts[:-1], BALL)
        return parts[-1:], (parts[0], parts[-1]), parts

    choices = {name: candidates(name) for name in names}
    n_alike = [Counter(chosen) for chosen in zip(*choices.values(), strict=True)]
    result = {}
    for name, own in choices.items():
        _, unit, denominator = split_quotient(name)
        unique = (parts for parts, alike in zip(own, n_alike, strict=True) if alike[parts] == 1)
        parts = next(unique, own[-1])
        symbol = SHOWN_IN.get(unit.symbol, unit.symbol) if unit else ""
        shown = UNITS.get(symbol) or DERIVED_UNITS.get(symbol.replace(" ", "_"))
        factor = unit.to_si / shown.to_si if unit and shown else 1.0
        words = plain(" ".join(parts).replace("_", " "))
        if denominator:
            symbol = f"{symbol or '1'}/{denominator}"
        result[name] = Display(words, symbol.replace("u", "µ").translate(SUPERSCRIPTS), round(factor, 9))
    return result


def quantity_words(key: str, beside: Collection[str] = ()) -> str:
    """Name of a quantity without its unit.

    Args:
        key: Its key.
        beside: Keys of all quantities of its cause; one without a unit is called a gain where another one would have the same name.

    Examples:
        >>> quantity_words("drift_x_T_per_h"), quantity_words("volume_m3")
        ('drift x', 'cubed radius of a ball')
        >>> quantity_words("x", ["x", "x_T"]), quantity_words("x_T", ["x", "x_T"])
        ('gain x', 'x')
    """
    name, unit, _ = split_quotient(key)
    words = BALL if unit and unit.symbol == "m3" else name.replace("_", " ")
    return f"gain {words}" if f"{key}_T" in beside else words


def are_counts(values: Num[np.ndarray, " draw"], display: Display) -> bool:
    """Whether draws are loop counts: whole numbers without a unit."""
    return not display.unit and bool(np.all(values == np.round(values)))


def summary(values: Num[np.ndarray, " draw"], display: Display) -> str:
    """Median and standard deviation of draws in their display unit, or the most probable count."""
    if are_counts(values, display):
        counts, number = np.unique(values, return_counts=True)
        best = int(number.argmax())
        return f"{counts[best]:.0f} ({probability(number[best] / len(values))})"
    return f"{with_sd(float(np.median(values)), float(values.std()))} {display.unit}".strip()


def size_with_unit(value: float, unit: str, digits: int = 2) -> str:
    """A size to two or more digits in the unit of its order: `12 µT`, `0.17 %`.

    Examples:
        >>> size_with_unit(1.234e-5, "T"), size_with_unit(0.00171, "1"), size_with_unit(3.2e-4, "T/h")
        ('12 µT', '0.17 %', '320 µT/h')
        >>> size_with_unit(0.0345678, "T", 4), size_with_unit(9.1e-8, "m3"), size_with_unit(0.085, "A m2")
        ('34.57 mT', '91 mm³', '85 mA m²')
        >>> size_with_unit(0.0054, "h"), size_with_unit(2.5, "h"), size_with_unit(1.0, "1")
        ('19 s', '2.5 h', '100 %')
        >>> size_with_unit(2.246547e-3, "m3")
        '2200 cm³'
    """
    if unit == "1" and abs(value) > 1.0:
        return f"{value:.3g}"
    factor, symbol = _unit_of(value, unit)
    return f"{float(f'{value / factor:.{digits}g}'):g}{symbol}"


def _unit_of(value: float, unit: str) -> tuple[float, str]:
    """The unit of a value's order: its size in `unit`, and its symbol behind a space; nothing for numbers of one and more."""
    if unit == "1":
        return (0.01, " %") if abs(value) <= 1.0 else (1.0, "")
    factor, prefix = 1.0, ""
    if unit.partition("/")[0] in PREFIXED:
        factor, prefix = next((p for p in PREFIXES if abs(value) >= p[0]), PREFIXES[-1])
    elif unit == "m3":
        factor, unit = (1e-6, "cm3") if abs(value) >= 1e-6 else (1e-9, "mm3")
    elif unit == "h" and abs(value) < 1.0:
        factor, unit = 1.0 / DERIVED_UNITS["h"].to_si, "s"
    return factor, f" {prefix}{unit}".translate(SUPERSCRIPTS)


def interval_with_unit(value: float, low: float, high: float, unit: str) -> str:
    """A value with its interval, in the unit of the larger one's order, to the first digit of the half-width; alone where it was set.

    Examples:
        >>> interval_with_unit(-1.0, -1.0, -1.0, "1"), interval_with_unit(0.1, 0.1, 0.1, "1")
        ('−1', '0.1')
        >>> interval_with_unit(0.01124, 0.01124, 0.01124, "1")
        '1.124 %'
        >>> interval_with_unit(0.13831, 0.13831, 0.13831, "h")
        '497.9 s'
        >>> interval_with_unit(0.0091, 0.0031, 0.015, "1"), interval_with_unit(-2.1e-4, -2.12e-4, -2.07e-4, "T")
        ('0.9 % (0.3 to 1.5 %)', '−210 µT (−212 to −207 µT)')
        >>> interval_with_unit(2.0, 1.5, 2.4, "1"), interval_with_unit(-3.8e-5, -0.0285, 0.0277, "rad")
        ('2.0 (1.5 to 2.4)', '0 mrad (−28 to 28 mrad)')
        >>> interval_with_unit(42e-6, 19e-6, 134e-6, "m3")
        '42 cm³ (19 to 134 cm³), a ball of 35 mm radius'
    """
    half_width = 0.5 * (high - low)
    factor, symbol = _unit_of(max(abs(value), half_width), unit)
    ball = f", a ball of {size_with_unit(math.cbrt(value), 'm')} radius" if unit == "m3" else ""
    if half_width <= 0.0:
        is_set = abs(value) >= 1.0 or value == float(f"{value:.0e}")  # as signs and factors of units are
        is_plain = unit == "1" and is_set
        factor, symbol = (1.0, "") if is_plain else (factor, symbol)
        return f"{value / factor:.4g}{symbol}{ball}".replace("-", "−")
    decimals = max(0, -math.floor(math.log10(half_width / factor)))
    middle, lower, upper = (
        f"{round(end / factor, decimals) + 0.0:.{decimals}f}" for end in (value, low, high)
    )
    return f"{middle}{symbol} ({lower} to {upper}{symbol}){ball}".replace("-", "−")


def microtesla(value_T: float) -> str:
    """A field in µT, to four digits."""
    return f"{value_T * 1e6:.4g} µT"


def percent(share: float, decimals: int = 0) -> str:
    """A share in per cent, with the space that the SI asks for.

    Examples:
        >>> percent(0.907), percent(0.9071, 1)
        ('91 %', '90.7 %')
    """
    return f"{100.0 * share:.{decimals}f} %"


def probability(share: float) -> str:
    """A probability in per cent; what is rounded is neither certain nor impossible.

    Examples:
        >>> probability(0.88), probability(0.9992), probability(0.005)
        ('88 %', '> 99 %', '< 1 %')
    """
    return "> 99 %" if share >= 0.995 else "< 1 %" if share <= 0.005 else percent(share)


def odds(log_evidence: float) -> str:
    """A difference of log evidence as odds, which need no logarithm.

    Examples:
        >>> odds(10.6), odds(-3.0), odds(0.2), odds(400.0)
        ('odds 40,000 to 1', 'odds 1 to 20', 'even odds', 'odds beyond a billion to 1')
    """
    size = abs(log_evidence)
    if size < EVEN:
        return "even odds"
    if size > math.log(1e9):
        number = "beyond a billion"
    else:
        ratio = float(f"{math.exp(size):.2g}" if size > 1.0 else f"{math.exp(size):.1f}")
        number = f"{ratio:,.0f}" if ratio >= 10.0 else f"{ratio:g}"
    return f"odds {number} to 1" if log_evidence > 0.0 else f"odds 1 to {number}"


def with_sd(value: float, sd: float) -> str:
    """A value with its standard deviation, both rounded to the second digit of the latter.

    Examples:
        >>> with_sd(50.98123, 0.0312), with_sd(48.0, 0.0), with_sd(1234.5, 87.2)
        ('50.981 ± 0.031', '48 ± 0', '1234 ± 87')
        >>> with_sd(-0.5, 0.1)
        '−0.50 ± 0.10'
    """
    if not (math.isfinite(value) and math.isfinite(sd)):
        return "not known"
    if sd == 0.0:
        return f"{value:.6g} ± 0"
    return f"{to_digit_of(sd, value)} ± {to_digit_of(sd, sd)}"


def to_digit_of(sd: float, value: float) -> str:
    """A value rounded to the second digit of a standard deviation; to six digits if that is zero.

    Examples:
        >>> to_digit_of(0.0312, 50.98123), to_digit_of(0.0, 0.00049), to_digit_of(0.1, -0.001), to_digit_of(352.0, 418.6)
        ('50.981', '0.00049', '0.00', '420')
    """
    if sd == 0.0 or not math.isfinite(sd):
        return f"{value:.6g}".replace("-", "−")
    digits = 1 - math.floor(math.log10(float(f"{sd:.1e}")))
    return f"{round(value, digits) + 0.0:.{max(0, digits)}f}".replace(
        "-", "−"
    )  # + 0.0: no minus sign before a zero


def plain(text: str) -> str:
    """A user's text, escaped so that it is not read as a formula."""
    return text.replace("$", r"\$")

"""Statements of `coilcal diagnose` about what readings could not have shown, mistakes of the record, and pieces of iron."""

from __future__ import annotations

import re
from collections.abc import Iterator

from estimator.effects import EFFECTS
from estimator.reporting.numbers import displays, quantity_words
from scripts.studies.judge.case import Case
from scripts.studies.judge.of_left import DIAGNOSE, plain_name
from scripts.studies.judge.reading import Readers
from scripts.studies.judge.statements import Statement, size_of

CLEARLY_VISIBLE = 8.0  # sigma of a flaw that a session shows beyond doubt
SAME_SD = (
    1.7  # factor between standard deviations of a calibration and of a diagnosis that left a few readings out
)
ROUNDED = 0.05  # of a printed volume
sentence = Readers()


@sentence(r"could not have shown, for example: (?P<items>.+?)\.(?: Where nothing of that kind|$)")
def could_not_have_shown(case: Case, _: str, match: re.Match[str]) -> Iterator[Statement]:
    """Sizes up to which causes stay unseen, and what absorbs them.

    False where such a flaw is hidden, no larger, and clearly visible; or where the number that absorbs it is not as sure as is said.
    """
    widths = {name: float(draws.std()) for name, draws in case.plain.flat_draws.items()}
    free = [parameter.name for parameter in case.as_described.free]
    shown = {displays(list(dict.fromkeys([*free, name])))[name].words: name for name in widths}
    for item in re.finditer(
        r"\((?P<label>\w+\[\w+\])\), up to (?P<size>.+?): (?P<number>[\w ]+) would absorb it, and be wrong by up to "
        r"(?P<wrong>[\d.]+ ?\S*) \((?P<sd>\d+) standard deviations\)",
        match["items"],
    ):
        if case.truth is not None:
            hidden = case.truth.cause(plain_name(item["label"]))
            told = re.match(r"(?P<key>[\w ]+?) (?P<size>[−\d.]+ ?[^\s,]*)", item["size"])
            sizes = {quantity_words(k): v for k, v in hidden.quantities.items()} if hidden is not None else {}
            is_below = told is not None and abs(sizes.get(told["key"], 0.0)) <= size_of(told["size"])
            is_true = hidden is None or (hidden.sigma or 0.0) < CLEARLY_VISIBLE or not is_below
            yield Statement("not_shown", DIAGNOSE, item[0], is_true, f"hidden: {case.truth.words}")
        if (name := shown.get(item["number"])) is not None and not name.endswith("turns"):
            sd, n = size_of(item["wrong"]) / widths[name], float(item["sd"])
            why = f"{sd:.2g} standard deviations of the draws of {name}"
            yield Statement(
                "absorbed", DIAGNOSE, item[0], (n - 0.5) / SAME_SD < sd < (n + 0.5) * SAME_SD, why
            )


@sentence(r"^[A-Z].*\((?P<label>[a-z]\w+(?:\[\w+\])?)\)\.$")
def mistake(case: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """A mistake of the record that is stated without a doubt."""
    name = plain_name(match["label"])
    if case.truth is not None and name in EFFECTS and EFFECTS[name].is_record_mistake:
        yield Statement("mistake", DIAGNOSE, text, case.truth.is_right(name), f"hidden: {case.truth.words}")


@sentence(
    r"(?P<volume>[\d.]+) (?P<unit>[cm]m³) \((?P<low>[\d.]+) to (?P<high>[\d.]+) [cm]m³\), "
    r"a ball of (?P<radius>[\d.]+ \S*m) radius"
)
def ball(_: Case, text: str, match: re.Match[str]) -> Iterator[Statement]:
    """That the cubed radius of a ball is that of its radius, between the ends of its interval."""
    unit_m3 = 1e-6 if match["unit"] == "cm³" else 1e-9
    volume, true = float(match["volume"]), size_of(match["radius"]) ** 3 / unit_m3
    step = 10.0 ** -len(match["volume"].partition(".")[2])
    is_true = abs(volume - true) <= 0.5 * step + 3.0 * ROUNDED * true
    is_true &= float(match["low"]) <= volume <= float(match["high"])
    yield Statement(
        "ball", DIAGNOSE, text, is_true, f"a ball of {match['radius']} has {true:.3g} {match['unit']}"
    )

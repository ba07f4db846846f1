"""What a diagnosis and a gain amount to, in the words of the log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from estimator.diagnosis.gain import Gain
from estimator.diagnosis.result import Diagnosis
from estimator.reporting.plots.style import displays, with_sd


def causes_of(found: Diagnosis) -> tuple[Mapping[str, Any], ...]:
    """As `diagnosis.json` holds them."""
    return tuple(found.record()["causes"])


def names_of(found: Diagnosis) -> str:
    """Names of the causes."""
    return " and ".join(cause["name"] for cause in causes_of(found))


def mistake_in(found: Diagnosis) -> str:
    """What is wrong with the record."""
    return f"a mistake of the record: {sizes_of(found)}"


def sizes_of(found: Diagnosis) -> str:
    """Causes with the sizes of their quantities."""
    return " and ".join(_size(cause) for cause in causes_of(found))


def _size(cause: Mapping[str, Any]) -> str:
    sizes = [_quantity(f"{cause['name']}.{key}", own) for key, own in cause["parameters"].items()]
    others = "".join(f" or {other['name']}" for other in cause["alternatives"])
    return f"{cause['name']}{others} ({', '.join(sizes)})"


def _quantity(name: str, own: Mapping[str, Any]) -> str:
    """A quantity as people read it; one in a unit such as T/h stays in that."""
    display, value, sd = displays([name])[name], own["median"], own["sd"]
    if display.unit or own["unit"] == "1":
        size = with_sd(value * display.factor, sd * display.factor) if sd else f"{value * display.factor:.4g}"
        return f"{display.words} {size} {display.unit}".rstrip()
    words = name.rpartition(".")[2].removesuffix("_" + own["unit"].replace("/", "_per_"))
    return f"{words} {value:.3g}" + (f" ± {sd:.1g}" if sd else "") + f" {own['unit']}"


def words_of(better: Gain) -> str:
    """Whether a new fit would be better, with the numbers."""
    words = (
        "predicts unseen readings better" if better.is_there else "does not predict unseen readings better"
    )
    return f"the new fit {words} than the current version (log density {better.elpd_difference:+.1f} ± {better.elpd_se:.1f})"

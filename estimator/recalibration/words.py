"""Causes of a diagnosis and the improvement of a new fit, in the words of the log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from estimator.diagnosis.gain import Gain
from estimator.diagnosis.result import Diagnosis
from estimator.reporting.plots.style import shown, with_sd


def causes_of(diagnosis: Diagnosis) -> tuple[Mapping[str, Any], ...]:
    """Causes as in `diagnosis.json`."""
    return tuple(diagnosis.record()["causes"])


def names_of(diagnosis: Diagnosis) -> str:
    """Names of the causes."""
    return " and ".join(cause["name"] for cause in causes_of(diagnosis))


def mistake_in(diagnosis: Diagnosis) -> str:
    """Mistakes of the record, with their sizes."""
    return f"a mistake of the record: {sizes_of(diagnosis)}"


def sizes_of(diagnosis: Diagnosis) -> str:
    """Causes with the sizes of their quantities."""
    return " and ".join(_size(cause) for cause in causes_of(diagnosis))


def _size(cause: Mapping[str, Any]) -> str:
    sizes = [_quantity(f"{cause['name']}.{key}", numbers) for key, numbers in cause["parameters"].items()]
    alternatives = "".join(f" or {alternative['name']}" for alternative in cause["alternatives"])
    return f"{cause['name']}{alternatives} ({', '.join(sizes)})"


def _quantity(name: str, numbers: Mapping[str, Any]) -> str:
    """A quantity in its display unit, or in its own unit if that has none, such as T/h."""
    show, value, sd = shown([name])[name], numbers["median"], numbers["sd"]
    if show.unit or numbers["unit"] == "1":
        size = with_sd(value * show.factor, sd * show.factor) if sd else f"{value * show.factor:.4g}"
        return f"{show.words} {size} {show.unit}".rstrip()
    words = name.rpartition(".")[2].removesuffix("_" + numbers["unit"].replace("/", "_per_"))
    return f"{words} {value:.3g}" + (f" ± {sd:.1g}" if sd else "") + f" {numbers['unit']}"


def words_of(improvement: Gain) -> str:
    """Whether a new fit predicts unseen readings better, with the numbers."""
    words = (
        "predicts unseen readings better"
        if improvement.is_there
        else "does not predict unseen readings better"
    )
    return f"the new fit {words} than the current version (log density {improvement.elpd_difference:+.1f} ± {improvement.elpd_se:.1f})"

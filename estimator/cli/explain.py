"""`coilcal explain`: what a cause is, how large it is in laboratories, and where that comes from."""

from __future__ import annotations

import inspect
import textwrap
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.options import json_option
from estimator.cli.output import CoilcalCommand, show

if TYPE_CHECKING:
    from estimator.effects.base import Effect, Quantity

WIDTH = 100


@click.command("explain", cls=CoilcalCommand)
@click.argument("name", metavar="[CAUSE]", required=False)
@json_option
def explain_command(name: str | None, as_json: bool) -> None:
    """Explain CAUSE, as a diagnosis names it; without CAUSE, list all causes and corrections.

    Priors are those of a session of one hour, one ampere and one metre; those of some causes grow with the session.
    """
    from estimator.effects import EFFECTS, effect_of

    if name is not None:
        effect = effect_of(name.partition("[")[0])
        show(_record(effect), _page(effect), as_json)
        return
    longest = max(map(len, EFFECTS))
    lines = [f"{each.name:{longest}}  {_kind(each):10}  {each.words}" for each in EFFECTS.values()]
    known = [{"name": each.name, "kind": _kind(each), "words": each.words} for each in EFFECTS.values()]
    show({"causes": known}, "\n".join(lines), as_json)


def _kind(effect: Effect) -> str:
    return "correction" if effect.is_correction else str(effect.kind)


def _record(effect: Effect) -> dict[str, Any]:
    from estimator.cli.words import prior_words

    return {
        "name": effect.name,
        "kind": _kind(effect),
        "words": effect.words,
        "explanation": _explanation(effect),
        "source": effect.source,
        "quantities": {
            quantity.key: {"unit": quantity.unit, "null": quantity.null, "prior": prior_words(quantity.prior)}
            for quantity in _quantities(effect)
        },
    }


def _page(effect: Effect) -> str:
    from estimator.cli.words import prior_words

    lines = [f"{effect.name} ({_kind(effect)}): {effect.words}", ""]
    for paragraph in _explanation(effect).split("\n\n"):
        lines += [*textwrap.wrap(" ".join(paragraph.split()), WIDTH), ""]
    if effect.is_record_mistake:
        lines += ["It is a mistake of the record: there or not, and asked before anything else.", ""]
    if effect.needs_winding:
        lines += ["Only coils with a winding can have it.", ""]
    keys = [quantity.key for quantity in _quantities(effect)]
    for quantity in _quantities(effect):
        note = ", says where or how, and does nothing by itself" if quantity.is_shape else ""
        unit = "a pure number" if quantity.unit == "1" else f"in {quantity.unit}"
        lines.append(f"  {quantity.key:{max(map(len, keys))}}  {unit}; {prior_words(quantity.prior)}{note}")
    lines += [*([""] if keys else []), *textwrap.wrap(f"Sizes: {effect.source}.", WIDTH)]
    return "\n".join(lines)


def _explanation(effect: Effect) -> str:
    return inspect.getdoc(type(effect)) or ""


def _quantities(effect: Effect) -> tuple[Quantity, ...]:
    from estimator.effects.circumstances import Extent

    return effect.quantities(Extent())

"""A rig inside a store: sessions, journals and calibrations hold it as the text of a rig file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text


def rig_state(rig: Rig) -> dict[str, Any]:
    """A rig as JSON can hold it.

    Raises:
        InvalidInput: It has numbers that no rig file may have, so nobody could open the store.
    """
    text = rig_text(rig)
    if rig_from_text(text, f"rig {rig.name!r}") != rig:
        raise InvalidInput(f"rig {rig.name!r} must be one that a rig file can hold; it has more than that")
    return {"text": text}


def rig_from_state(state: Mapping[str, Any], file: str) -> Rig:
    """The rig that `rig_state` described, of this version or of 0.1; `file` names its origin in messages.

    Version 0.1 kept the user's own text, and beside it the values that were set and the parameters that were free by then.
    """
    rig = rig_from_text(state["text"], file)
    if "values" not in state:
        return rig
    rig = rig.with_values(state["values"])
    broken = rig.broken_rule()
    if broken is not None:
        raise InvalidInput(f"{broken[0]} {broken[1]}; received {broken[2]} ({file})")
    return rig.with_fixed(parameter.name for parameter in rig.free if parameter.name not in state["free"])

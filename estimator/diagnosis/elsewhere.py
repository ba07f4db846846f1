"""Work of a diagnosis on another device: fits go there, and what is found comes back to the processor.

Where readings are decides where all that is computed from them is, as everywhere. The search and the corrections are such work, always in
double precision; what judges, counts and reports reads plain numbers and stays on the processor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import torch
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.readings.observations import Observations

Found = TypeVar("Found")


def computed_on(device: torch.device, work: Callable[..., Found], *fits: Fit) -> Found:
    """What some work finds from fits on the processor, done on a device; there it is just done.

    Args:
        device: Where tensors are while it is done.
        work: Takes the fits there. Found are fits, tensors, and frozen records and collections of these.
        fits: What it starts from.
    Returns: The same on the processor. Fits, and readings of fits, that were passed in are the same objects again.
    """
    there = _Move(device)
    moved = [there.of(fit) for fit in fits]
    if all(moved_fit is fit for moved_fit, fit in zip(moved, fits, strict=True)):
        return work(*fits)
    return _Move(fits[0].observations.device, there.reversed).of(work(*moved))


class _Move:
    """A move of records to a device. What occurs several times is moved once, so that it is the same object there too.

    Args:
        device: Where to.
        known: Pairs of an object and what it is there, by the identity of the first.
    """

    def __init__(
        self, device: torch.device, known: Mapping[int, tuple[object, object]] | None = None
    ) -> None:
        self.device = device
        self._known = dict(known or {})

    @property
    def reversed(self) -> dict[int, tuple[object, object]]:
        """What was moved, the other way round."""
        return {id(there): (there, here) for here, there in self._known.values()}

    def of(self, what: Found) -> Found:
        """A fit, tensor, record or collection as it is on the device of this move."""
        if id(what) not in self._known:
            self._known[id(what)] = (what, self._moved(what))
        return cast("Found", self._known[id(what)][1])

    def _moved(self, what: Any) -> Any:
        if isinstance(what, Tensor | Observations):
            return what.to(self.device)
        if isinstance(what, Fit):
            readings = self.of(what.observations)
            return what if readings is what.observations else what.to(readings)
        if isinstance(what, tuple | list):
            moved_each = [self.of(value) for value in what]
            if all(there is here for there, here in zip(moved_each, what, strict=True)):
                return what
            return what._make(moved_each) if hasattr(what, "_make") else type(what)(moved_each)
        if isinstance(what, dict):
            by_key = {key: self.of(value) for key, value in what.items()}
            return what if all(by_key[key] is what[key] for key in what) else by_key
        if is_dataclass(what) and not isinstance(what, type):
            own = {each.name: getattr(what, each.name) for each in fields(what) if each.init}
            moved = {name: self.of(value) for name, value in own.items()}
            return what if all(moved[name] is own[name] for name in own) else replace(what, **moved)
        return what

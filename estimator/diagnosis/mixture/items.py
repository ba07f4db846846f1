"""Items of the dictionary of what may be wrong: a cause or a departure at one start, with some of its quantities and one width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.linear import Projector
from estimator.diagnosis.mixture.links import Link
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Item:
    """One thing that may be wrong.

    Attributes:
        cause: Name and place.
        is_listed: A cause with a name; else a departure.
        link: Where in the chain it acts.
        start: Its shapes.
        keys: Quantities that its columns belong to.
        columns: Their numbers in the dictionary.
        widths: Prior standard deviation of each, in units of its column.
        shift: Number of the column by which its start changes the predictions; None where it does not.
        log_prior: Among all items.
        is_one_sided: Its only quantity cannot be negative.
        log_prior_of_start: Of a listed cause, whatever its quantities and their widths.
        is_chosen: Whether its start has an instant, an axis or another shape that no fit moves.
    """

    cause: Cause
    is_listed: bool
    link: Link
    start: dict[str, float]
    keys: tuple[str, ...]
    columns: tuple[int, ...]
    widths: tuple[float, ...]
    shift: int | None
    log_prior: float
    is_one_sided: bool = False
    log_prior_of_start: float = 0.0
    is_chosen: bool = False

    @property
    def name(self) -> str:
        """Items with the same name do not stand beside each other: those of a listed cause; those of a departure at one start."""
        if self.is_listed or not self.start:
            return self.cause.label
        return f"{self.cause.label} {sorted(self.start.items())}"

    @property
    def repeated(self) -> str:
        """Name of the items beside which alone this one stands, such as those of a first piece of iron; empty for most."""
        repeats = EFFECTS[self.cause.name].repeats if self.cause.name in EFFECTS else None
        return Cause(repeats.name, self.cause.place).label if repeats else ""


@dataclass(frozen=True)
class Dictionary:
    """All items at one fit.

    Attributes:
        items: What may be wrong.
        columns: Whitened changes of the predictions: of quantities, and of starts.
        residual: Whitened, with every item absent and the rig's numbers at their prior means.
        always: Removes what is always there: the rig's numbers within their priors.
        prior_precision: Of these.
    """

    items: tuple[Item, ...]
    columns: Float[Tensor, "component column"]
    residual: Float[Tensor, " component"]
    always: Projector
    prior_precision: Float[Tensor, "parameter parameter"]

    def changed(self, chosen: Sequence[int], sizes: Float[Tensor, " size"]) -> Float[Tensor, " component"]:
        """Whitened change of the predictions by some items.

        Args:
            chosen: Their numbers.
            sizes: Coefficients of their columns, one item after the other.
        """
        items = [self.items[i] for i in chosen]
        columns = [column for item in items for column in item.columns]
        shifts = [item.shift for item in items if item.shift is not None]
        return self.columns[:, columns] @ sizes.to(self.columns) + self.columns[:, shifts].sum(1)

    def restricted(self, numbers: Sequence[int]) -> Dictionary:
        """Some of the items, with the columns that these have."""
        items, columns = renumbered(self.items, numbers)
        return replace(self, items=items, columns=self.columns[:, columns])


def renumbered(items: Sequence[Item], numbers: Sequence[int]) -> tuple[tuple[Item, ...], list[int]]:
    """Some of the items, whose columns are numbered anew, and these columns by the numbers that they had."""
    used = dict[int, int]()
    for i in numbers:
        for column in (*items[i].columns, *(() if items[i].shift is None else (items[i].shift,))):
            used.setdefault(column, len(used))

    def moved(item: Item) -> Item:
        shift = None if item.shift is None else used[item.shift]
        return replace(item, columns=tuple(used[column] for column in item.columns), shift=shift)

    return tuple(moved(items[i]) for i in numbers), list(used)

"""The dictionary of what may be wrong, at a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.mixture.departures import Departure
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.items import Dictionary, Item
from estimator.diagnosis.mixture.links import link_of
from estimator.diagnosis.mixture.listed import Offered
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent


class _Stack:
    """Blocks of columns, each with a number once."""

    def __init__(self) -> None:
        self.blocks: list[Tensor] = []
        self.first: dict[int, int] = {}
        self.n = 0

    def number_of(self, block: Tensor) -> int:
        """Number of the first column of a block, or of a single column."""
        if id(block) not in self.first:
            self.first[id(block)] = self.n
            self.blocks.append(block.reshape(len(block), -1))
            self.n += self.blocks[-1].shape[1]
        return self.first[id(block)]


def dictionary(
    expansion: Expansion, listed: Sequence[Offered], departures: Sequence[Departure]
) -> Dictionary:
    """All items at an expansion."""
    stack = _Stack()
    extent = expansion.fit.circumstances.extent
    items = [_listed_item(entry, stack, extent) for entry in listed]
    items += [item for departure in departures for item in _departure_items(departure, stack)]
    residual = expansion.residual
    columns = torch.cat(stack.blocks, dim=1) if stack.blocks else residual.new_zeros(len(residual), 0)
    return Dictionary(tuple(items), columns, residual, expansion.always, expansion.prior_precision)


def _listed_item(one: Offered, stack: _Stack, extent: Extent) -> Item:
    candidate, shapes = one.start.candidate, one.start.shapes
    effect = EFFECTS[candidate.cause.name]
    first = stack.number_of(candidate.columns)
    of_shapes: tuple[int, ...] = ()
    if shapes is not None and shapes.shape[1]:
        begin = stack.number_of(shapes)
        of_shapes = tuple(range(begin, begin + shapes.shape[1]))
    widths = (*(float(candidate.prior_sd[i]) * one.width for i in one.subset), *(1.0 for _ in of_shapes))
    return Item(
        cause=candidate.cause,
        is_listed=True,
        link=link_of(effect),
        start=candidate.shapes,
        keys=tuple(candidate.keys[i] for i in one.subset),
        columns=(*(first + i for i in one.subset), *of_shapes),
        widths=widths,
        shift=None if candidate.is_at_null else stack.number_of(candidate.shift),
        log_prior=math.log(policy.LISTED) + one.log_prior,
        is_one_sided=not of_shapes and candidate.cannot_be_negative(one.subset),
        log_prior_of_start=one.start.log_prior,
        is_chosen=any(q.is_shape and q.is_fixed for q in effect.quantities(extent)),
    )


def _departure_items(one: Departure, stack: _Stack) -> list[Item]:
    first, n = [stack.number_of(block) for block in one.blocks], len(one.keys) // len(one.blocks)
    columns = tuple(begin + i for begin in first for i in range(n))
    return [
        Item(
            cause=one.cause,
            is_listed=False,
            link=link_of(one.effect),
            start=one.start,
            keys=one.keys,
            columns=columns,
            widths=tuple(amplitude * width for width in one.widths),
            shift=None,
            log_prior=math.log(policy.DEPARTURE) + one.log_prior,
        )
        for amplitude in policy.AMPLITUDES
    ]

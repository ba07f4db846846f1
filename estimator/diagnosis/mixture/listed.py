"""Items of the listed causes: each cause at each place and start, whole and by some of its quantities, at several widths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, at_starts
from estimator.diagnosis.hypotheses.instants import instants_in, starts_nearer
from estimator.diagnosis.mixture.evidence_kernel import log_bayes_factors_of_choices
from estimator.diagnosis.mixture.items import Item
from estimator.effects import EFFECTS
from estimator.effects.base import Quantity
from estimator.effects.circumstances import UNTIL
from estimator.rig.parameters import Uniform
from estimator.rig.rig import Cause
from estimator.side_by_side import each

# Items of a cause whose log posterior is further below that of its best item cannot matter beside it
WITHIN = 12.0
MOST_PER_CAUSE, MOST_OF_FAINT = 10, 2
STARTS_OF_MANY = 8  # that are offered of a cause with more starts than items
FAINT = (
    -6.0
)  # log posterior of the best item of a cause against nothing: fainter ones are there to be counted
# Log posterior of the best coarse start against nothing from which on finer instants and nearer places are asked.
WORTH_A_FINER_START = -3.0
MOST_ROUNDS = 12  # of a search for the best place
FIRST_STEP, LAST_STEP = 0.06, 0.006  # of that search, in widths of the prior
MOST_TOGETHER = 64  # candidates of one batch, which bounds the memory
LEAST_SEEN = 0.1  # of the noise, in all readings together: what shows less cannot be told from nothing


@dataclass(frozen=True)
class Start:
    """A cause at one start.

    Attributes:
        candidate: With its columns.
        log_prior: Of this cause and start, within the listed causes.
        shapes: Columns of shapes that are free, in units of their priors; None where its start is all that is known of them.
    """

    candidate: Candidate
    log_prior: float
    shapes: Tensor | None = None


@dataclass(frozen=True)
class Offered:
    """One item before its columns have numbers.

    Attributes:
        start: Cause, start and columns.
        subset: Its quantities.
        width: Factor on their stated widths.
        log_prior: Within the listed causes.
    """

    start: Start
    subset: tuple[int, ...]
    width: float
    log_prior: float


def starts_of(fit: Fit, pool: Sequence[Candidate]) -> list[Start]:
    """Candidates that some reading would show, with their priors: names alike, then places, then starts."""
    pool = [candidate for candidate in pool if _is_seen(fit, candidate)]
    places: dict[str, set[str]] = {}
    n_starts: dict[Cause, int] = {}
    for candidate in pool:
        cause = candidate.cause
        places.setdefault(cause.name, set()).add(cause.place)
        n_starts[cause] = n_starts.get(cause, 0) + 1
    return [Start(c, -math.log(len(places) * len(places[c.cause.name]) * n_starts[c.cause])) for c in pool]


def _is_seen(fit: Fit, candidate: Candidate) -> bool:
    reached = (fit.projector.norms(candidate.columns) * candidate.prior_sd).max()
    return float(reached) > LEAST_SEEN or not candidate.is_at_null


def offered(fit: Fit, starts: Sequence[Start], are_places_known: bool = False) -> list[Offered]:
    """The items of each cause that are not far less probable than its best one, at instants between readings and places between starts.

    Args:
        fit: Whose residual is asked.
        starts: Of all causes, at coarse instants.
        are_places_known: The best places are among the starts.
    """
    weighed = _weighed(fit, starts)
    finer = list[Start]()
    for by_item in weighed.values():
        best = max(by_item, key=lambda of_start: of_start.best)
        if best.best > WORTH_A_FINER_START:
            finer += _at_finer_instants(fit, best)
            finer += [] if are_places_known else _at_nearer_places(fit, best)
    for cause, by_item in _weighed(fit, finer).items():
        weighed[cause] += by_item
    return [item for by_item in weighed.values() for item in _most_probable(by_item)]


def present_items(starts: Sequence[Start]) -> list[Offered]:
    """The items of causes that a fit has."""
    return [item for start in starts for item in _items(start)]


def places_in(fit: Fit, items: Sequence[Item]) -> dict[Cause, dict[str, float]]:
    """The most probable place of each listed cause that has one, by items that were offered."""
    best = {item.cause: item.start for item in reversed(items) if item.is_listed}
    return {cause: start for cause, start in best.items() if _places(fit, cause)}


def again(fit: Fit, starts: Sequence[Start], cause: Cause, shapes: dict[str, float]) -> list[Start]:
    """A cause at shapes that an earlier fit has found, with the prior of its other starts; none where the fit has it."""
    log_prior = [start.log_prior for start in starts if start.candidate.cause == cause]
    if not log_prior or not shapes:
        return []
    return [Start(candidate, log_prior[0]) for candidate in at_starts(fit, cause, [shapes])]


def _at_finer_instants(fit: Fit, coarse: _Weighed) -> list[Start]:
    """Starts of a cause at instants between readings near its coarse ones, which share its prior.

    Where something ends too, its beginning is asked once more when its end is known.
    """
    circumstances, cause, best = fit.circumstances, coarse.start.candidate.cause, coarse
    keys = instants_in(coarse.start.candidate.shapes)
    coarse_h = circumstances.coarse_instants_h if UNTIL in keys else circumstances.instants_h
    result = list[Start]()
    for key in [*keys, *keys[:-1]]:
        nearer = starts_nearer(circumstances, coarse_h, best.start.candidate.shapes, key)
        if len(nearer) > 1:
            log_prior = coarse.start.log_prior - math.log(len(nearer))
            starts = [Start(near, log_prior) for near in at_starts(fit, cause, nearer)]
            best = max(_weighed(fit, starts)[cause], key=lambda at: at.best)
            result += starts
    return result


def _at_nearer_places(fit: Fit, coarse: _Weighed) -> list[Start]:
    """The start at the best place near a coarse one, by a compass search in the linear model; none where the cause has no place.

    A piece of iron between two coarse places shows a quarter of its evidence at the nearer one.

    References: Kolda, Lewis and Torczon, SIAM Review 45, 385 (2003), for compass searches.
    """
    cause, places = coarse.start.candidate.cause, _places(fit, coarse.start.candidate.cause)
    best, step = coarse, FIRST_STEP
    for _ in range(MOST_ROUNDS if places else 0):
        shapes = best.start.candidate.shapes
        around = [
            {**shapes, q.key: shapes.get(q.key, q.null) + side * step * (upper - lower)}
            for q, lower, upper in places
            for side in (-1.0, 1.0)
        ]
        inside = [
            near
            for near in around
            if all(lower < near.get(q.key, q.null) < upper for q, lower, upper in places)
        ]
        starts = [Start(near, coarse.start.log_prior) for near in at_starts(fit, cause, inside)]
        nearer = max(_weighed(fit, starts).get(cause, []), key=lambda at: at.best, default=None)
        if nearer is not None and nearer.best > best.best:
            best = nearer
        elif (step := 0.5 * step) < LAST_STEP:
            break
    return [] if best is coarse else [best.start]


def _places(fit: Fit, cause: Cause) -> list[tuple[Quantity, float, float]]:
    """What says where a cause acts, with its bounds; nothing where that is a single number, whose starts lie densely."""
    quantities = EFFECTS[cause.name].quantities(fit.circumstances.extent)
    places = [
        (q, q.prior.lower, q.prior.upper)
        for q in quantities
        if q.is_shape and not q.is_fixed and isinstance(q.prior, Uniform)
    ]
    return places if len(places) > 1 else []


def _items(start: Start) -> list[Offered]:
    """Half of the prior is for all quantities together, half for some of them."""
    return [
        Offered(start, subset, width, start.log_prior + share)
        for (subset, width), share in zip(*_choices(start.candidate), strict=True)
    ]


def _choices(candidate: Candidate) -> tuple[list[tuple[tuple[int, ...], float]], list[float]]:
    """Quantities and factors on their widths, and log priors of these."""
    subsets = candidate.subsets
    each, log_priors = [], []
    for subset in subsets:
        share = 0.5 if subset == subsets[-1] else 0.5 / (len(subsets) - 1)
        for width, weight in policy.WIDTHS:
            each.append((subset, width))
            log_priors.append(math.log(weight * (1.0 if len(subsets) == 1 else share)))
    return each, log_priors


@dataclass(frozen=True)
class _Weighed:
    """Log posterior of every item of one start, up to a constant."""

    start: Start
    values: Float[Tensor, " item"]

    @property
    def best(self) -> float:
        """Log posterior of the most probable item."""
        return float(self.values.max())


def _weighed(fit: Fit, starts: Sequence[Start]) -> dict[Cause, list[_Weighed]]:
    """Every item, weighed alone, by its cause."""
    pool = [start.candidate for start in starts]
    result: dict[Cause, list[_Weighed]] = {}
    for some, gram, products in _inner_products(fit, pool):
        score = products[:, :-1] - gram[:, :-1, -1]
        started = products[:, -1] - 0.5 * gram[:, -1, -1]
        prior_sd = torch.stack([pool[i].prior_sd for i in some])
        choices, log_priors = _choices(pool[some[0]])
        values = np.empty((len(some), len(choices)))
        log_bayes_factors_of_choices(
            gram.cpu().numpy(),
            score.cpu().numpy(),
            prior_sd.cpu().numpy(),
            np.cumsum([0, *(len(subset) for subset, _ in choices)]),
            np.array([column for subset, _ in choices for column in subset]),
            np.array([width for _, width in choices]),
            np.array([[pool[i].cannot_be_negative(subset) for subset, _ in choices] for i in some]),
            values,
        )
        values += started.cpu().numpy()[:, None] + np.array(log_priors)
        for i, of_start in zip(some, values, strict=True):
            start = starts[i]
            weighed = torch.from_numpy(of_start + start.log_prior)
            result.setdefault(start.candidate.cause, []).append(_Weighed(start, weighed))
    return result


def _inner_products(
    fit: Fit, pool: Sequence[Candidate]
) -> list[tuple[list[int], Float[Tensor, "candidate column column"], Float[Tensor, "candidate column"]]]:
    """Numbers of candidates with the same quantities, and inner products of their columns and, last, shifts.

    Those with each other are less what the fit can follow; then come those with the residual.
    """
    alike: dict[tuple[str, ...], list[int]] = {}
    for i, candidate in enumerate(pool):
        alike.setdefault(candidate.keys, []).append(i)
    batches = [
        members[first : first + MOST_TOGETHER]
        for members in alike.values()
        for first in range(0, len(members), MOST_TOGETHER)
    ]
    projector, residual = fit.projector, fit.residual

    def of_batch(some: list[int]) -> tuple[list[int], Tensor, Tensor]:
        rows = torch.stack([torch.cat((pool[i].columns.T, pool[i].shift[None])) for i in some])
        # One product for all: many small ones take two to sixteen times as long.
        followed = rows.flatten(0, 1) @ projector.jacobian @ projector.factor
        followed = followed.unflatten(0, rows.shape[:2])
        return some, rows @ rows.mT - followed @ followed.mT, rows @ residual

    return list(each(of_batch, batches))


def _most_probable(by_start: Sequence[_Weighed]) -> list[Offered]:
    """The items of one cause that may matter: the most probable ones, and of a cause with many starts the best of several of them.

    Beside what acts too another of its periods may be the right one.
    """
    values = torch.stack([of_start.values for of_start in by_start])
    best = float(values.max())
    most = MOST_PER_CAUSE if best > FAINT else MOST_OF_FAINT
    top = values.flatten().topk(min(most, values.numel()))
    rows = [
        i for i, value in zip(top.indices.tolist(), top.values.tolist(), strict=True) if value > best - WITHIN
    ]
    n = values.shape[1]
    if len(values) > MOST_PER_CAUSE and best > FAINT:
        of_each, item = values.max(1)
        starts = of_each.topk(STARTS_OF_MANY).indices
        rows += [row for row in (starts * n + item[starts]).tolist() if row not in rows]
    return [_items(by_start[i // n].start)[i % n] for i in rows]

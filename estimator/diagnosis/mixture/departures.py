"""Items of the departures: smooth or stepwise functions at one link of the chain, which no list names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.kinds import CorrectionKind, kinds_of
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.diagnosis.mixture.following import stalled
from estimator.diagnosis.mixture.links import Link, link_of
from estimator.effects.corrections.correction import Correction
from estimator.rig.rig import EVERYWHERE, Cause
from estimator.side_by_side import each

SAME = 1e-2  # of the square of columns: what a listed cause leaves of those that it can change as well
MOST_STARTS = 4  # of one kind: the most probable ones, alone
DOUBLING = 2  # of a degree to the next that is asked
MOST_COLUMNS, MOST_EVERYWHERE = (
    120,
    200,
)  # of one departure that is not whole: at one place, and at all together
# Causes and departures change readings alike about two predictions that differ by this share of the rms field
NEAR = 0.02


@dataclass(frozen=True)
class Departure:
    """One kind of departure at one start, up to one degree.

    Attributes:
        cause: Its name, and the place or `EVERYWHERE`.
        effect: What it is.
        start: What its terms are functions of, where several are asked.
        keys: Of its amplitudes; with the place before, where it acts at several.
        blocks: By place, whitened columns of all its degrees, at one scale; the first ones are those of its keys.
        widths: Of each column, for an rms of 1 in units of the noise.
        log_prior: Within the departures, for each amplitude.
    """

    cause: Cause
    effect: Correction
    start: dict[str, float]
    keys: tuple[str, ...]
    blocks: tuple[Float[Tensor, "component column"], ...]
    widths: tuple[float, ...]
    log_prior: float


@dataclass(frozen=True)
class Changes:
    """What causes and departures change in the readings about a fit, also used about others with nearly the same predictions.

    Attributes:
        expansion: The fit.
        kinds: All kinds of departures that a session may have.
        columns: By kind, whitened changes per unit of each amplitude, at each start; of a moved expansion they are made one kind at a time.
        pool: Listed causes.
    """

    expansion: Expansion
    kinds: tuple[CorrectionKind, ...]
    columns: Iterable[Float[Tensor, "start component amplitude"]]
    pool: tuple[Candidate, ...]

    @classmethod
    def about(cls, expansion: Expansion, causes: Sequence[Cause]) -> Changes:
        """About a fit, of some listed causes."""
        fit = expansion.fit
        kinds = tuple(
            kind
            for kind in kinds_of(fit)
            if kind.limit.degree >= kind.lowest
            and not kind.effect.single  # one step of it is a listed cause, or one that readings cannot tell from a listed one
        )
        columns = each(lambda kind: kind.columns(fit, kind.starts, _highest(kind)), kinds)
        return cls(expansion, kinds, tuple(columns), tuple(candidates(fit, list(causes))))

    def is_near(self, fit: Fit) -> bool:
        """Whether the predictions of a fit are nearly those of this one, and follow the rig's numbers as well."""
        own = self.expansion.fit
        apart = (fit.predicted_T - own.predicted_T).square().sum()
        if float(apart) >= NEAR**2 * float(own.predicted_T.square().sum()):
            return False
        return not bool(stalled(own, fit).any())

    def moved(self, expansion: Expansion, causes: Sequence[Cause]) -> Changes:
        """Changes about a fit nearby, of some listed causes.

        What the rig follows of a column moves with the rig: else the difference of the two would look like a cause where nearly all of a
        column can be followed, as of turns that are wound otherwise.
        """
        if expansion.fit is self.expansion.fit:
            return self
        old, fit, keys = self.expansion, expansion.fit, expansion.keys
        shared = [key for key in old.keys if key in keys]
        before = old.always.jacobian[:, [old.keys.index(key) for key in shared]]
        now = expansion.always.jacobian[:, [keys.index(key) for key in shared]]
        factor = old.always.factor[[old.keys.index(key) for key in shared]]
        lighter = fit.whitening_per_T / old.fit.whitening_per_T.clamp(min=1e-300)

        def moved(columns: Float[Tensor, "component column"]) -> Tensor:
            followed = factor @ (old.always.basis.T @ columns)
            return lighter[:, None] * (columns - before @ followed) + now @ followed

        known = {candidate.cause for candidate in self.pool}
        pool = [
            replace(c, columns=moved(c.columns), shift=moved(c.shift[:, None])[:, 0])
            for c in self.pool
            if c.cause in set(causes)
        ]
        pool += candidates(fit, [cause for cause in causes if cause not in known])
        columns = (torch.stack([moved(start) for start in of_kind]) for of_kind in self.columns)
        return Changes(expansion, self.kinds, columns, tuple(pool))


def departures(changes: Changes, fit: Fit, listed: Sequence[Candidate]) -> list[Departure]:
    """All departures of a session, of each kind with many starts the most probable ones alone.

    Args:
        changes: Of the readings.
        fit: Whose residual is asked.
        listed: Listed causes. A departure that changes the readings as one of them can is that one.
    """
    kinds = changes.kinds
    by_link: dict[Link, set[str]] = {}
    places: dict[str, int] = {}
    for kind in kinds:
        by_link.setdefault(link_of(kind.effect), set()).add(kind.cause.name)
        places[kind.cause.name] = places.get(kind.cause.name, 0) + 1
    result = list[Departure]()
    for kind, of_kind in zip(kinds, changes.columns, strict=True):
        n_places = places[kind.cause.name]
        n = len(by_link) * len(by_link[link_of(kind.effect)]) * (n_places + (n_places > 1) * n_places)
        result += [
            Departure(
                kind.cause,
                kind.effect,
                start if len(kind.starts) > 1 else {},
                keys,
                (columns,),
                widths,
                share - math.log(n * len(policy.AMPLITUDES)),
            )
            for start, keys, columns, widths, share in _of_kind(fit, kind, of_kind)
        ]
    unlisted = _without_listed(result, listed)
    return [*unlisted, *_everywhere(unlisted, places)]


def _everywhere(made: Sequence[Departure], n_places: Mapping[str, int]) -> list[Departure]:
    """Departures at all places of their kind at once, each with amplitudes of its own: what probes of one make have in common."""
    alike: dict[tuple[str, int], list[Departure]] = {}
    for departure in made:
        if not departure.start:
            alike.setdefault((departure.cause.name, len(departure.keys)), []).append(departure)
    return [
        Departure(
            Cause(name, EVERYWHERE),
            some[0].effect,
            {},
            tuple(f"{member.cause.place}.{key}" for member in some for key in member.keys),
            tuple(block for member in some for block in member.blocks),
            tuple(width for member in some for width in member.widths),
            some[0].log_prior + math.log(len(some)),
        )
        for (name, n_keys), some in alike.items()
        if len(some) == n_places[name] > 1 and len(some) * n_keys <= MOST_EVERYWHERE
    ]


def _without_listed(made: Sequence[Departure], listed: Sequence[Candidate]) -> list[Departure]:
    """Departures that change the readings otherwise than a listed cause can, or those of one place together.

    Gains and crosstalk of the axes make any response that is linear.
    """
    bases = [*(_basis(candidate) for candidate in listed), *_bases_together(listed)]
    most = max((basis.shape[1] for basis in bases), default=0)
    some = [departure for departure in made if len(departure.keys) <= most]
    if not some:
        return list(made)
    own = [d.blocks[0][:, : len(d.keys)] * d.blocks[0].new_tensor(d.widths) for d in some]
    followed = _summed(_summed((torch.cat(bases, 1).T @ torch.cat(own, 1)).square(), bases).T, own)
    square = torch.stack([columns.square().sum() for columns in own])
    is_listed = (square - followed.amax(1) < SAME * square).tolist()
    gone = {id(departure) for departure, is_gone in zip(some, is_listed, strict=True) if is_gone}
    return [departure for departure in made if id(departure) not in gone]


def _bases_together(listed: Sequence[Candidate]) -> list[Float[Tensor, "component column"]]:
    """What the listed causes of one place change together, those whose shapes are known."""
    of_cause: dict[Cause, list[Candidate]] = {}
    for candidate in listed:
        of_cause.setdefault(candidate.cause, []).append(candidate)
    alike: dict[str, list[Candidate]] = {}
    for cause, starts in of_cause.items():
        if len(starts) == 1 and starts[0].is_at_null:
            alike.setdefault(cause.place, []).append(starts[0])
    return [_basis(*some) for some in alike.values() if len(some) > 1]


def _basis(*candidates: Candidate) -> Float[Tensor, "component column"]:
    """Orthonormal basis of what listed causes change in the readings, to first order about their starts."""
    columns = torch.cat([candidate.columns for candidate in candidates], dim=1)
    shifts = [candidate.shift[:, None] for candidate in candidates if not candidate.is_at_null]
    columns = torch.cat((columns, *shifts), dim=1)
    unit = columns / columns.square().sum(0).sqrt().clamp(min=1e-300)
    basis, singular, _ = torch.linalg.svd(unit, full_matrices=False)
    return basis[:, singular > SAME * singular[:1]]


def _summed(rows: Float[Tensor, "row column"], blocks: Sequence[Tensor]) -> Float[Tensor, "block column"]:
    """Sums of the rows that belong to each block's columns."""
    number = torch.repeat_interleave(torch.tensor([block.shape[1] for block in blocks]))
    return rows.new_zeros(len(blocks), rows.shape[1]).index_add(0, number.to(rows.device), rows)


_Made = tuple[dict[str, float], tuple[str, ...], Tensor, tuple[float, ...], float]


def _of_kind(
    fit: Fit, kind: CorrectionKind, columns: Float[Tensor, "start component amplitude"]
) -> list[_Made]:
    """Starts, keys, columns, widths and log prior of one kind."""
    if len(kind.starts) == 1:
        highest, of_start = _highest(kind), columns[0]
        degrees = [highest] if kind.effect.is_whole else _asked(kind.lowest, highest)
        share = -math.log(len(degrees))
        return [_up_to(kind, kind.starts[0], of_start, degree, share) for degree in degrees]
    value = _best_evidence(fit, columns)
    chosen = value.topk(min(MOST_STARTS, len(value))).indices.tolist()
    share = -math.log(len(kind.starts))
    # A view would keep the columns of all starts in memory.
    return [_up_to(kind, kind.starts[i], columns[i].clone(), kind.lowest, share) for i in chosen]


def _highest(kind: CorrectionKind) -> int:
    """Highest degree that is asked: where one frequency of many is to be found, the lowest."""
    if len(kind.starts) > 1:
        return kind.lowest
    if kind.effect.is_whole:
        return kind.limit.degree
    return max(degree for degree, _ in kind.keys(kind.limit.degree)[:MOST_COLUMNS])


def _up_to(
    kind: CorrectionKind, start: dict[str, float], columns: Tensor, degree: int, log_prior: float
) -> _Made:
    keys = kind.keys(degree)
    relative = columns.new_tensor([kind.effect.relative_width(d) for d, _ in keys])
    scale = float((columns[:, : len(keys)] * relative).square().sum(1).mean().sqrt())
    widths = tuple((relative / max(scale, 1e-300)).tolist())
    return start, tuple(key for _, key in keys), columns, widths, log_prior


def _asked(lowest: int, highest: int) -> list[int]:
    """Degrees that are asked: the lowest, then twice as high each time, and the highest.

    Examples:
        >>> _asked(1, 12)
        [1, 2, 4, 8, 12]
    """
    degrees, degree = [], lowest
    while degree < highest:
        degrees.append(degree)
        degree = max(degree + 1, DOUBLING * degree)
    return [*degrees, highest]


def _best_evidence(fit: Fit, columns: Float[Tensor, "start component column"]) -> Float[Tensor, " start"]:
    """Highest log Bayes factor over the amplitudes of each start, alone."""
    followed = columns.mT @ fit.projector.basis
    gram = columns.mT @ columns - followed @ followed.mT
    score = columns.mT @ fit.residual
    power = columns.square().sum((1, 2)) / columns.shape[1]
    best = torch.full_like(power, -math.inf)
    for amplitude in policy.AMPLITUDES:
        variance = amplitude**2 / power.clamp(min=1e-300)
        own = gram * variance[:, None, None]
        factor, failed = torch.linalg.cholesky_ex(own + torch.eye(own.shape[-1]).to(own))
        reached = torch.linalg.solve_triangular(
            factor, (score * variance.sqrt()[:, None])[:, :, None], upper=False
        )
        value = 0.5 * reached.square().sum((1, 2)) - torch.diagonal(factor, dim1=1, dim2=2).log().sum(1)
        best = best.maximum(torch.where(failed == 0, value, -math.inf))
    return best

"""Design matrix columns of each cause: whitened, at a fit, for every place and every start of its shapes."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.limits import Limits
from estimator.effects import EFFECTS
from estimator.effects.base import AFTER, Effect
from estimator.effects.circumstances import SINCE, UNTIL, is_meanwhile
from estimator.effects.during import During
from estimator.effects.segments import split_key
from estimator.effects.stages import MotionEffect, MountEffect
from estimator.model.cause_columns import cause_columns, causes_beside
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig
from estimator.side_by_side import each

_LOG = logging.getLogger(__name__)
MOST_ALONE = 6  # quantities that singles and pairs tell of well enough
NO_CHANGE = 1e-6  # in units of the noise: what rounding leaves of what changes no reading, on any device


@dataclass(frozen=True)
class Candidate:
    """One cause at one place with one start of its shapes.

    Attributes:
        cause: Name and place.
        shapes: Start of its shapes.
        keys, units: Quantities that its columns belong to, and their units.
        shift: Whitened change of the predictions at the start; rounding where the start is the null.
        columns: Whitened change of the predictions per unit of each quantity.
        prior_sd: Of the quantities.
        one_sided: Numbers of the quantities that start at the lower bound of their prior.
    """

    cause: Cause
    shapes: dict[str, float]
    keys: tuple[str, ...]
    units: tuple[str, ...]
    shift: Float[Tensor, " component"]
    columns: Float[Tensor, "component column"]
    prior_sd: Float[Tensor, " column"]
    one_sided: tuple[int, ...] = ()

    @property
    def is_at_null(self) -> bool:
        """Whether it changes no prediction at its start."""
        return float(self.shift.abs().max()) < NO_CHANGE

    def cannot_be_negative(self, subset: tuple[int, ...]) -> bool:
        """Whether some of its quantities are a single one that starts at the lower bound of its prior."""
        return len(subset) == 1 and subset[0] in self.one_sided

    @property
    def subsets(self) -> tuple[tuple[int, ...], ...]:
        """Columns that may be present alone: each, each pair, those of one sensor element or segment, all but these, and (last) all."""
        n = len(self.keys)
        if n == 1:
            return ((0,),)
        subsets: list[tuple[int, ...]] = [(i,) for i in range(n)]
        if n > 2:
            subsets += list(combinations(range(n), 2))
        subsets += self._parts
        of_some = dict.fromkeys(subset for subset in subsets if 0 < len(subset) < n)
        return (*of_some, tuple(range(n)))

    @property
    def _parts(self) -> list[tuple[int, ...]]:
        """Columns of each sensor element, or of each segment, and all but these; columns of one quantity in all segments."""
        of_segments = [part for part in map(split_key, self.keys) if part]
        groupings: list[list[int | str]] = []
        if of_segments:
            groupings = [[number for number, _ in of_segments], [rest for _, rest in of_segments]]
        elif len(self.keys) > MOST_ALONE:
            groupings = [[key[0] for key in self.keys]]
        return [
            tuple(i for i, group in enumerate(groups) if (group == chosen) is is_in)
            for groups in groupings
            for chosen in dict.fromkeys(groups)
            for is_in in (True, False)
        ]


def causes_of(rig: Rig, fit: Fit, limits: Limits | None = None) -> list[Cause]:
    """Continuous causes that the rig does not have yet, that concern the session, and that the limits allow, where there are any."""
    beside = causes_beside(rig, fit.circumstances)
    return [cause for cause in beside if limits is None or limits.allows(EFFECTS[cause.name])]


def candidates(fit: Fit, causes: list[Cause]) -> list[Candidate]:
    """Candidates of every cause at a fit, start by start; starts without finite columns are left out, and of a whole cause that is said."""
    circumstances = fit.circumstances
    starts_of = {cause: list(EFFECTS[cause.name].starts(circumstances, cause.place)) for cause in causes}
    staying = [cause for cause in causes if EFFECTS[cause.name].stays is None]
    of_staying = each(lambda cause: at_starts(fit, cause, starts_of[cause]), staying)
    known = dict(zip(staying, of_staying, strict=True))
    result = list[Candidate]()
    for cause in causes:
        if cause in known:
            result += known[cause]
            continue
        effect, starts = EFFECTS[cause.name], starts_of[cause]
        stays = None if effect.stays is None else Cause(effect.stays.name, cause.place)
        steps = {c.shapes[SINCE]: c for c in result if c.cause == stays}
        is_known = bool(steps) and all(start[key] in steps for start in starts for key in (SINCE, UNTIL))
        result += _spells(cause, starts, steps) if is_known else at_starts(fit, cause, starts)
    for name in {cause.name for cause in causes if starts_of[cause]} - {c.cause.name for c in result}:
        _say_left_out(name)
    return result


@cache
def _say_left_out(name: str) -> None:
    """Once in a process, since it is the same at every fit."""
    _LOG.warning("%s is not asked: readings with it, or their derivatives, are not all finite", name)


def _spells(
    cause: Cause, starts: Sequence[dict[str, float]], steps: Mapping[float, Candidate]
) -> list[Candidate]:
    """Candidates of what ends at one instant, each the difference of two of what stays.

    Args:
        cause: Name and place.
        starts: Instants at which each spell begins and ends.
        steps: Candidates of what stays, by their instants.
    """
    return [
        replace(
            steps[start[SINCE]],
            cause=cause,
            shapes=start,
            shift=steps[start[SINCE]].shift - steps[start[UNTIL]].shift,
            columns=steps[start[SINCE]].columns - steps[start[UNTIL]].columns,
        )
        for start in starts
    ]


def at_starts(fit: Fit, cause: Cause, starts: list[dict[str, float]]) -> list[Candidate]:
    """Candidates of one cause, start by start; those without finite columns are left out."""
    effect = EFFECTS[cause.name]
    if len(starts) > 1 and _moves_meanwhile(effect):
        return _meanwhile(fit, cause, starts)
    is_alike = not isinstance(effect, MountEffect)  # whose columns depend on the start
    groups = filter(None, [starts] if is_alike else [[shapes] for shapes in starts])
    return [candidate for together in groups for candidate in _at_starts(fit, cause, together)]


def _moves_meanwhile(effect: Effect) -> bool:
    """Whether an effect moves a body for a part of a session, and is the same whenever that is."""
    if isinstance(effect, MountEffect):
        return effect.is_step
    return isinstance(effect, During) and isinstance(effect, MotionEffect)


def _meanwhile(fit: Fit, cause: Cause, starts: list[dict[str, float]]) -> list[Candidate]:
    """Candidates of what moves a body for a part of a session, each what would move it always without the readings outside that part.

    A reading depends on where the body was when it was taken, so that one prediction serves all instants.
    """
    circumstances = fit.circumstances
    always = {SINCE: 0.0, UNTIL: AFTER * circumstances.duration_h}

    def between(candidate: Candidate, start: dict[str, float]) -> Candidate:
        instants_h = {key: candidate.shift.new_tensor(start[key]) for key in start if key in always}
        is_there = is_meanwhile(circumstances.hours, instants_h)
        rows = fit.posterior.measured_components(is_there[:, None].expand(-1, 3)).to(candidate.shift)
        shift, columns = candidate.shift * rows, candidate.columns * rows[:, None]
        return replace(candidate, shapes=start, shift=shift, columns=columns)

    of_whole = {**starts[0], **{key: value for key, value in always.items() if key in starts[0]}}
    return [between(candidate, start) for candidate in _at_starts(fit, cause, [of_whole]) for start in starts]


def _at_starts(fit: Fit, cause: Cause, starts: list[dict[str, float]]) -> list[Candidate]:
    """Candidates of one cause from starts of the same shapes: one prediction for all of them."""
    measured, per_T = fit.posterior.measured_components, fit.whitening_per_T
    made = cause_columns(fit.posterior.model, fit.values, cause, starts, fit.at_sensor_T)
    shifts = (measured(made.started_T) - fit.predicted_T) * per_T
    whitened = (measured(made.slope_T) * per_T).mT
    keys, units = tuple(q.key for q in made.quantities), tuple(q.unit for q in made.quantities)
    prior_sd = per_T.new_tensor([q.prior.sd for q in made.quantities])
    first = [starts[0].get(key, made.rig.parameters[f"{cause.label}.{key}"].value) for key in keys]
    one_sided = tuple(
        i for i, q in enumerate(made.quantities) if isinstance(q.prior, Normal) and first[i] <= q.prior.lower
    )
    return [
        Candidate(cause, shapes, keys, units, shift, columns, prior_sd, one_sided)
        for shapes, shift, columns in zip(starts, shifts, whitened, strict=True)
        if bool(torch.isfinite(columns).all() and torch.isfinite(shift).all())
    ]

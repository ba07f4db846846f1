"""An effect that is there for a part of a session: from one instant on, or for a while.

Instants lie between two readings. The column of what ends is that of the change at its beginning less that of the change at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any, ClassVar

from estimator.effects import stages
from estimator.effects.base import AFTER, WHEN, Effect, Kind, Quantities, Starts, Theta, since, until
from estimator.effects.circumstances import SINCE, UNTIL, Circumstances, Extent, is_meanwhile
from estimator.effects.declaring import made
from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.tensors import Tensor, torch


class During(Effect):
    """An effect that is there from one instant on and, where it ends, until another.

    Attributes:
        base: What is there meanwhile; it says which places and sessions can have it.
        ends: It ends at an instant of its own.
    """

    base: ClassVar[Any]
    ends: ClassVar[bool] = False
    depends_on: ClassVar[str | None] = WHEN

    def quantities(self, extent: Extent) -> Quantities:
        """Quantities of the effect, and the times since the session began at which it begins and ends, in h."""
        instants = (since(extent), until(extent)) if self.ends else (since(extent),)
        return (*self.base.quantities(extent), *instants)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Shapes of the effect, each from every instant on, or in every spell."""
        shapes = self.base.starts(circumstances, place)
        if not self.ends:
            return from_instants(shapes, circumstances)
        spells = spells_of(circumstances, place if self.kind is Kind.SENSOR else None)
        return tuple({**start, **spell} for start in shapes for spell in spells)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """The rule of the effect that its values break."""
        of_base = {key: value for key, value in values.items() if key not in (SINCE, UNTIL)}
        return self.base.broken_rule(of_base)


def during(
    base: Effect, source_of: Effect | None = None, **declared: Any
) -> Callable[[Callable[[], None]], During]:
    """Make an effect that is there from one instant on, of an empty function, which has its name and says what has happened.

    Args:
        base: What is there from then on: of a current, what a sensor says, a steady field that is the same at every point, the place of a
            mover, or rows of the record. It need not be a cause by itself.
        source_of: Effect with the source of the priors, unless the docstring has one; the base by default.
        **declared: Attributes as `Effect.cause` has them.
    Raises:
        InvalidInput: The base is none of these, or the declaration is wrong.
    """
    stage = _stage_of(base)
    same = ("kind", "is_record_mistake", "places", "concerns", "meaning")
    of_base = {key: getattr(base, key) for key in same}

    def joined(function: Callable[[], None]) -> During:
        return made(stage, function, {**of_base, **declared, "base": base}, source=(source_of or base).source)

    return joined


def spell(stays: During, **declared: Any) -> Callable[[Callable[[], None]], During]:
    """Make an effect that is there for a while, as `during` does.

    Args:
        stays: What begins alike and does not end.
        **declared: As with `during`.
    """
    return during(stays.base, source_of=stays, stays=stays, ends=True, **declared)


def from_instants(shapes: Starts, circumstances: Circumstances) -> Starts:
    """Each of some starts from every instant on; from every other one where there are shapes, and so many starts."""
    has_shapes = any(shapes)
    instants_h = circumstances.coarse_instants_h if has_shapes else circumstances.instants_h
    return tuple({**start, SINCE: instant_h} for start in shapes for instant_h in instants_h)


def instants_within(circumstances: Circumstances, place: str, least_share: float = 0.0) -> Starts:
    """Instants with a reading of the sensor, and at least such a share of its readings, before and after."""
    hours = circumstances.hours[circumstances.is_of(place)]
    least = max(1.0, least_share * len(hours))
    n_after = [int((hours >= instant_h).sum()) for instant_h in circumstances.instants_h]
    each = zip(circumstances.instants_h, n_after, strict=True)
    return tuple({SINCE: instant_h} for instant_h, n in each if least <= n <= len(hours) - least)


def spells_of(circumstances: Circumstances, sensor: str | None = None, has_ends: bool = False) -> Starts:
    """Spells that causes start from: every two of some instants, with a reading between and one outside.

    Args:
        circumstances: Of the readings.
        sensor: Whose readings count; all by default.
        has_ends: Whether one may begin with the session or last until after it.
    """
    hours = circumstances.hours if sensor is None else circumstances.hours[circumstances.is_of(sensor)]
    instants_h = circumstances.coarse_instants_h
    if has_ends:
        instants_h = (0.0, *instants_h, AFTER * circumstances.duration_h)
    spells = [{SINCE: begin_h, UNTIL: end_h} for begin_h, end_h in combinations(instants_h, 2)]
    n_meanwhile = [int(((hours >= each[SINCE]) & (hours < each[UNTIL])).sum()) for each in spells]
    return tuple(each for each, n in zip(spells, n_meanwhile, strict=True) if 0 < n < len(hours))


class _Changed(During):
    """What the first argument of a stage becomes meanwhile."""

    def apply(self, given: Tensor, theta: Theta, circumstances: Circumstances, place: Any) -> Tensor:
        changed = self.base.apply(given, theta, circumstances, place)
        return torch.where(is_meanwhile(circumstances.hours, theta)[..., None], changed, given)


class _Current(_Changed, stages.CurrentEffect):
    pass


class _Reading(_Changed, stages.ReadingEffect):
    pass


class _Room(During, stages.RoomEffect):
    """A field that is the same at every point."""

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> stages.Components:
        field_T = self.base.steady_T(circumstances.hours.new_zeros(1, 3), theta)
        return field_T * is_meanwhile(circumstances.hours, theta)[..., None]


class _Motion(During, stages.MotionEffect):
    def columns(self, circumstances: Circumstances, mover: str) -> stages.Columns:
        own = self.base.columns(circumstances, mover)
        return torch.cat((circumstances.hours_for_instants[:, None], own), dim=-1)

    def apply(self, pose: Transform, columns: stages.Columns, theta: Theta) -> Transform:
        rotation, moved = pose.rotation, self.base.apply(pose, columns[:, 1:], theta)
        is_there = is_meanwhile(columns[:, 0], theta)[..., None]
        if moved.rotation is not rotation:
            rotation = torch.where(is_there[..., None], moved.rotation, rotation)
        return Transform(rotation, torch.where(is_there, moved.translation_m, pose.translation_m))


class _Record(During, stages.RecordEffect):
    def rows_late(self, values: Mapping[str, float]) -> int:
        return self.base.rows_late(values)

    def late_since_h(self, values: Mapping[str, float]) -> float:
        return values[SINCE]


STAGES: tuple[tuple[type[Effect], str, type[During]], ...] = (
    (stages.CurrentEffect, "apply", _Current),
    (stages.ReadingEffect, "apply", _Reading),
    (stages.RoomEffect, "steady_T", _Room),
    (stages.MotionEffect, "apply", _Motion),
    (stages.RecordEffect, "rows_late", _Record),
)


def _stage_of(base: Effect) -> type[During]:
    """How an effect acts for a part of a session."""
    for stage, method, meanwhile in STAGES:
        if isinstance(base, stage) and getattr(type(base), method) is not getattr(stage, method):
            return meanwhile
    raise InvalidInput(
        f"{base.name} must be of a current, a reading, a steady field, a mover or rows to be there for a part of a session"
    )

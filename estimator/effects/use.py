"""The effects of a rig, ready for the model: declaration and place together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Generic, TypeVar

from jaxtyping import Bool

from estimator.effects import EFFECTS, ORDER
from estimator.effects.base import Effect, Kind, Theta
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import MotionEffect, MountEffect, RecordEffect
from estimator.errors import InvalidInput
from estimator.readings.observations import Observations
from estimator.rig.bodies import Body, Mover
from estimator.rig.rig import Cause, Rig
from estimator.tensors import Tensor, torch

E_co = TypeVar("E_co", bound=Effect, covariant=True)


@dataclass(frozen=True)
class Use(Generic[E_co]):
    """One effect at one place of a rig.

    Attributes:
        own_keys: Keys of its quantities; None where only the numbers of the rig tell.
    """

    effect: E_co
    place: str
    own_keys: tuple[str, ...] | None = field(default=None, compare=False)

    @property
    def cause(self) -> Cause:
        """Name and place of the effect, as rigs hold them."""
        return Cause(self.effect.name, self.place)

    @property
    def label(self) -> str:
        """Cause and place, as in rig files."""
        return self.cause.label

    def keys(self, rig: Rig) -> tuple[str, ...]:
        """Keys of the effect's quantities in a rig."""
        return rig.keys_by_label.get(self.label, ())

    def theta(self, values: Mapping[str, Tensor]) -> Theta:
        """Quantities of the effect among all numbers of the rig, broadcast to one batch."""
        prefix = f"{self.label}."
        keys = self.own_keys
        if keys is None:
            keys = tuple(name[len(prefix) :] for name in values if name.startswith(prefix))
        theta = {key: values[prefix + key] for key in keys}
        if not any(value.dim() for value in theta.values()):
            return theta
        return dict(zip(theta, torch.broadcast_tensors(*theta.values()), strict=True))

    def concerned(self, circumstances: Circumstances) -> Bool[Tensor, " reading"] | None:
        """Readings of its sensor; None stands for all."""
        if self.effect.kind is not Kind.SENSOR:
            return None
        return circumstances.sensor == self.index(circumstances.rig.sensors)

    def where_concerned(self, circumstances: Circumstances, changed: Tensor, other: Tensor) -> Tensor:
        """What the effect makes of its readings; all else as it is."""
        concerned = self.concerned(circumstances)
        return changed if concerned is None else torch.where(concerned[:, None], changed, other)

    def index(self, bodies: Sequence[Body | Mover]) -> int:
        """Index of its place among the rig's coils, sensors or movers."""
        return [body.name for body in bodies].index(self.place)


def uses_of(rig: Rig, stage: type[E_co], place: str | None = None) -> tuple[Use[E_co], ...]:
    """Effects of a stage (and place), in the order in which they act."""
    return tuple(
        Use(effect, where, rig.keys_by_label.get(label, ()))
        for effect, where, label in _of_stage(rig.acting, stage, place)
    )


def shifts_rows(effect: Effect) -> bool:
    """Whether an effect puts fields beside other rows; a rig has one such effect at most."""
    return isinstance(effect, RecordEffect) and type(effect).rows_late is not RecordEffect.rows_late


def is_in_field(rig: Rig, cause: Cause) -> bool:
    """Whether a cause changes the field that a calibration predicts; else only how readings of it came about.

    Where a mover stands that carries a sensor says where a reading was taken, not what the field is there; so does how a sensor is mounted.
    """
    effect = EFFECTS[cause.name]
    if isinstance(effect, MountEffect):
        return any(coil.name == cause.place for coil in rig.coils)
    if isinstance(effect, MotionEffect):
        carriers = [{body.carried_by for body in bodies} for bodies in (rig.coils, rig.sensors)]
        return cause.place in carriers[0] - carriers[1]
    return effect.changes_field


def as_meant(rig: Rig, observations: Observations) -> Observations:
    """The readings with each field beside the pose and the currents that it belongs to, as mistakes of the record in the rig have it."""
    late = [use for use in uses_of(rig, RecordEffect) if shifts_rows(use.effect)]
    if not late:
        return observations.realigned(0)
    if len(late) > 1:
        raise InvalidInput(
            f"effects must shift the rows of a record once; received {' and '.join(use.label for use in late)}"
        )
    (use,), nominal = late, rig.nominal_values()
    values = {key: nominal[f"{use.label}.{key}"] for key in use.keys(rig)}
    return observations.realigned(use.effect.rows_late(values), use.effect.late_since_h(values))


@lru_cache(maxsize=4096)
def _of_stage(
    causes: tuple[Cause, ...], stage: type[E_co], place: str | None
) -> tuple[tuple[E_co, str, str], ...]:
    """Effects of a stage among some causes, with their places and labels, in the order in which they act."""
    return tuple(
        (effect, cause.place, cause.label)
        for cause in sorted(causes, key=lambda cause: ORDER[cause.name])
        if isinstance(effect := EFFECTS[cause.name], stage) and (place is None or cause.place == place)
    )

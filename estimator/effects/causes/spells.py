"""What is otherwise for a while and then as before: a supply in another range, a trolley that stood there, a switch that was turned twice.

Each is a cause that stays from one instant on, but for its end at another. Both instants lie between two readings. Its column is that of
the change at its beginning less that of the change at its end.
"""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import AFTER, WHEN, Effect, Kind, Quantity, Theta, since, until
from estimator.effects.causes.record_since import CurrentSignSince
from estimator.effects.causes.robot import MoverSlipped
from estimator.effects.causes.sensor import AxisGain
from estimator.effects.causes.sensor_history import OffsetStep
from estimator.effects.causes.supply import CurrentStep
from estimator.effects.causes.surroundings import BackgroundStep
from estimator.effects.circumstances import SINCE, UNTIL, Circumstances, Extent
from estimator.tensors import Tensor, torch


class Spell(Effect):
    """A cause that stays from one instant on, but for its end."""

    stays: ClassVar[Effect]

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Quantities of the cause that stays, and the time since the session began at which it ends, in h."""
        return (*self.stays.quantities(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Shapes of the cause that stays, each in every spell."""
        shapes = [
            {key: value for key, value in start.items() if key != SINCE}
            for start in self.stays.starts(circumstances, place)
        ]
        each_one = dict.fromkeys(tuple(start.items()) for start in shapes)
        spells = spells_of(circumstances, place if self.kind is Kind.SENSOR else None)
        return tuple({**dict(start), **spell} for start in each_one for spell in spells)


class CurrentSignSpell(Spell, CurrentSignSince):
    """For a while the leads of a coil are exchanged, or its current is written with the other sign."""

    name: ClassVar[str] = "current_sign_spell"
    words: ClassVar[str] = "for a while the coil is connected the other way round"
    stays: ClassVar[Effect] = CurrentSignSince()


class CurrentSpell(Spell, CurrentStep):
    """For a while the coil carries less current: another range of its supply, a bad contact."""

    name: ClassVar[str] = "current_spell"
    words: ClassVar[str] = "for a while the coil carries another share of its current"
    source: ClassVar[str] = "a supply in another range, a contact that warms: 0.1 to 2 %"
    stays: ClassVar[Effect] = CurrentStep()


class BackgroundSpell(Spell, BackgroundStep):
    """For a while the field of the room is another, everywhere alike."""

    name: ClassVar[str] = "background_spell"
    words: ClassVar[str] = "for a while the field of the room is another"
    source: ClassVar[str] = (
        "a door, a lift or a trolley that came and went, another coil that was on: 1 to 50 uT"
    )
    stays: ClassVar[Effect] = BackgroundStep()


class MoverSpell(Spell, MoverSlipped):
    """For a while the mover stands elsewhere than it says, as far everywhere: another tool frame, a wrong height in part of a record."""

    name: ClassVar[str] = "mover_spell"
    words: ClassVar[str] = "for a while the mover stands elsewhere than it says"
    source: ClassVar[str] = "another tool or work frame in part of a program, 0.1 to 1 mm"
    stays: ClassVar[Effect] = MoverSlipped()


class OffsetSpell(Spell, OffsetStep):
    """For a while the zero of the sensor is another."""

    name: ClassVar[str] = "offset_spell"
    words: ClassVar[str] = "for a while the sensor shows another constant in no field"
    source: ClassVar[str] = "another range of the amplifier, a contact: 10 to 100 uT"
    stays: ClassVar[Effect] = OffsetStep()


class GainSpell(AxisGain):
    """For a while the sensor's axes have other gains: another range, or numbers in another unit.

    No cause says that gains alone change and stay, so a spell may begin with the session or last until after it.
    """

    name: ClassVar[str] = "gain_spell"
    words: ClassVar[str] = "for a while the sensor's axes have other gains"
    source: ClassVar[str] = "ranges of one amplifier agree to 0.1 to 2 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of each gain, and the times since the session began at which that begins and ends, in h."""
        return (*super().quantities(extent), since(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Each spell with readings of the sensor."""
        return spells_of(circumstances, place, has_ends=True)

    def beyond_the_moment(self, key: str) -> str | None:
        """A spell needs a session to lie in."""
        return WHEN

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        changed_T = super().apply(field_sensor_T, theta, circumstances, sensor)
        return torch.where(circumstances.is_meanwhile(theta)[..., None], changed_T, field_sensor_T)


def spells_of(
    circumstances: Circumstances, sensor: str | None = None, has_ends: bool = False
) -> tuple[dict[str, float], ...]:
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
    spells = [
        {SINCE: begin_h, UNTIL: end_h}
        for i, begin_h in enumerate(instants_h)
        for end_h in instants_h[i + 1 :]
    ]
    n_meanwhile = [int(((hours >= spell[SINCE]) & (hours < spell[UNTIL])).sum()) for spell in spells]
    return tuple(spell for spell, n in zip(spells, n_meanwhile, strict=True) if 0 < n < len(hours))

"""What is otherwise for a while and then as before: a supply in another range, a trolley that stood there, a switch that was turned twice.

Each is a change from one instant on that ends at another. Both lie between two readings. Its column is that of the change at its
beginning less that of the change at its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.effects.base import AFTER, WHEN, Quantity, Theta, since, until
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.record import CurrentSign
from estimator.effects.robot import MoverSlipped
from estimator.effects.sensor import AxisGain
from estimator.effects.sensor_history import OffsetStep
from estimator.effects.supply import CurrentStep
from estimator.effects.surroundings import BackgroundStep
from estimator.frames import Transform


class CurrentSignSpell(CurrentSign):
    """For a while the leads of a coil are exchanged, or its current is written with the other sign."""

    name: ClassVar[str] = "current_sign_spell"
    words: ClassVar[str] = "for a while the coil is connected the other way round"
    is_structural: ClassVar[bool] = False

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Sign of the current meanwhile, and the times since the session began at which that begins and ends, in h."""
        return (*super().quantities(extent), since(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Reversed, in each spell."""
        reversals = super().starts(circumstances, place)
        return tuple({**start, **spell} for start in reversals for spell in spells_of(circumstances))

    def beyond_the_moment(self, key: str) -> str | None:
        """A spell needs a session to lie in."""
        return WHEN

    def apply(
        self,
        current_A: Float[Tensor, "*#batch reading coil"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Delivered currents."""
        reversed_A = super().apply(current_A, theta, circumstances, coil)
        is_meanwhile = circumstances.is_between(theta["since_h"], theta["until_h"])
        return torch.where(is_meanwhile[..., None], reversed_A, current_A)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """A sign is a sign."""
        return super().broken_rule({"sign": values["sign"]})


class CurrentSpell(CurrentStep):
    """For a while the coil carries less current: another range of its supply, a bad contact."""

    name: ClassVar[str] = "current_spell"
    words: ClassVar[str] = "for a while the coil carries another share of its current"
    source: ClassVar[str] = "a supply in another range, a contact that warms: 0.1 to 2 %"
    spell_of: ClassVar[str] = "current_step"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share that is lost, and the times since the session began at which that begins and ends, in h."""
        return (*super().quantities(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Each spell."""
        return spells_of(circumstances)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        is_meanwhile = circumstances.is_between(theta["since_h"], theta["until_h"])
        return current_A * (1.0 - theta["step"][..., None] * is_meanwhile)


class BackgroundSpell(BackgroundStep):
    """For a while the field of the room is another, everywhere alike."""

    name: ClassVar[str] = "background_spell"
    words: ClassVar[str] = "for a while the field of the room is another"
    source: ClassVar[str] = (
        "a door, a lift or a trolley that came and went, another coil that was on: 1 to 50 uT"
    )
    spell_of: ClassVar[str] = "background_step"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Components in the world frame, and the times since the session began at which that begins and ends, in h."""
        return (*super().quantities(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Each spell."""
        return spells_of(circumstances)

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*#batch reading 3"]:
        """Additional field of the room in the world frame, in T; 0 before and after."""
        field_T = torch.stack([theta[f"{axis}_T"] for axis in "xyz"], dim=-1)
        is_meanwhile = circumstances.is_between(theta["since_h"], theta["until_h"])
        return field_T[..., None, :] * is_meanwhile[..., None]


class MoverSpell(MoverSlipped):
    """For a while the mover stands elsewhere than it says, as far everywhere: another tool frame, a wrong height in part of a record."""

    name: ClassVar[str] = "mover_spell"
    words: ClassVar[str] = "for a while the mover stands elsewhere than it says"
    source: ClassVar[str] = "another tool or work frame in part of a program, 0.1 to 1 mm"
    spell_of: ClassVar[str] = "mover_slipped"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift in the frame that the mover reports in, and the times since the session began at which that begins and ends, in h."""
        return (*super().quantities(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Each spell."""
        return spells_of(circumstances)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        shifted = super().apply(pose, columns, theta)
        is_over = columns[:, 0] >= theta["until_h"][..., None]
        return Transform(
            pose.rotation, torch.where(is_over[..., None], pose.translation_m, shifted.translation_m)
        )


class GainSpell(AxisGain):
    """For a while the sensor's axes have other gains: another range, or numbers in another unit."""

    name: ClassVar[str] = "gain_spell"
    words: ClassVar[str] = "for a while the sensor's axes have other gains"
    source: ClassVar[str] = "ranges of one amplifier agree to 0.1 to 2 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of each gain, and the times since the session began at which that begins and ends, in h."""
        return (*super().quantities(extent), since(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Each spell with readings of the sensor; from the first reading on and to the last one, too, for no other cause says that."""
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
        is_meanwhile = circumstances.is_between(theta["since_h"], theta["until_h"])
        return torch.where(is_meanwhile[..., None], changed_T, field_sensor_T)


class OffsetSpell(OffsetStep):
    """For a while the zero of the sensor is another."""

    name: ClassVar[str] = "offset_spell"
    words: ClassVar[str] = "for a while the sensor shows another constant in no field"
    source: ClassVar[str] = "another range of the amplifier, a contact: 10 to 100 uT"
    spell_of: ClassVar[str] = "offset_step"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Change of each component in the sensor frame, and the times since the session began at which it begins and ends, in h."""
        return (*super().quantities(extent), until(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Each spell with readings of the sensor."""
        return spells_of(circumstances, place)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        zero_T = torch.stack([theta[f"{axis}_T"] for axis in "xyz"], dim=-1)
        is_meanwhile = circumstances.is_between(theta["since_h"], theta["until_h"])
        return field_sensor_T + zero_T[..., None, :] * is_meanwhile[..., None]


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
        (begin_h, end_h)
        for i, begin_h in enumerate(instants_h)
        for end_h in instants_h[i + 1 :]
        if 0 < int(((hours >= begin_h) & (hours < end_h)).sum()) < len(hours)
    ]
    return tuple({"since_h": begin_h, "until_h": end_h} for begin_h, end_h in spells)

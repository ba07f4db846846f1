"""Links of the chain from a supply to a recorded number, and at which of them an effect acts."""

from __future__ import annotations

from enum import StrEnum

from estimator.effects.base import Effect
from estimator.effects.stages import (
    CoreMagnetisation,
    CoreMemory,
    CurrentEffect,
    ElementEffect,
    HolderEffect,
    MotionEffect,
    MountEffect,
    ReadingEffect,
    RoomEffect,
    SidesEffect,
    SourceEffect,
    WindingEffect,
    WindingMagnetisation,
)

OF_ZERO = ("sensor_offset", "offset_", "segment_zero", "zero_", "current_pickup")


class Link(StrEnum):
    """One part of the chain; the words are stable (docs/file-formats.md)."""

    CURRENT = "current"
    WINDING = "winding"
    ROOM = "room"
    MOVER = "mover"
    MOUNT = "mount"
    RESPONSE = "response"
    ZERO = "zero"
    RECORD = "record"

    @property
    def words(self) -> str:
        """The link in a sentence."""
        return WORDS[self]


WORDS = {
    Link.CURRENT: "the current of a coil",
    Link.WINDING: "the field of a coil",
    Link.ROOM: "the field of the room",
    Link.MOVER: "where a mover stands",
    Link.MOUNT: "how coil or sensor are mounted",
    Link.RESPONSE: "what a sensor makes of the field",
    Link.ZERO: "what a sensor shows without a field",
    Link.RECORD: "how the readings were written down",
}

BY_STAGE: tuple[tuple[type[Effect], Link], ...] = (
    (CurrentEffect, Link.CURRENT),
    (WindingEffect, Link.WINDING),
    (SidesEffect, Link.WINDING),
    (SourceEffect, Link.WINDING),
    (WindingMagnetisation, Link.WINDING),
    (CoreMagnetisation, Link.WINDING),
    (CoreMemory, Link.WINDING),
    (RoomEffect, Link.ROOM),
    (MotionEffect, Link.MOVER),
    (MountEffect, Link.MOUNT),
    (ElementEffect, Link.MOUNT),
    (HolderEffect, Link.MOUNT),
)


def link_of(effect: Effect) -> Link:
    """The link at which an effect acts.

    Examples:
        >>> from estimator.effects import EFFECTS
        >>> link_of(EFFECTS["coil_heating"]).value, link_of(EFFECTS["offset_drift"]).value
        ('current', 'zero')
    """
    if isinstance(effect, ReadingEffect):
        return Link.ZERO if effect.name.startswith(OF_ZERO) else Link.RESPONSE
    return next((link for stage, link in BY_STAGE if isinstance(effect, stage)), Link.RECORD)

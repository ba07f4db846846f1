"""Flaws of the supply: the coil does not carry the current that was commanded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.flaw import Cause, Known, Stage, Truth, sign
from tests.hidden.scene import Scene


def current_gain(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Delivered = gain x commanded. Twin of the number of turns: never visible."""
    gain = 1.0 + sign(rng) * size
    return replace(scene, current_A=gain * scene.current_A), Truth("coil1", (Known("gain", gain, "1"),))


def current_offset(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Delivered = commanded + offset, also where 0 is commanded. Twin of the turns where one current is used."""
    offset_A = sign(rng) * size
    return replace(scene, current_A=scene.current_A + offset_A), Truth(
        "coil1", (Known("offset_A", offset_A, "A"),)
    )


def coil_heating(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A supply that holds its voltage: the current falls as the coil's resistance grows with its temperature.

    Delivered = commanded / (1 + size x (T - T0) / rise): T is the coil's temperature (room and own heating, of first order in I^2),
    T0 the room's 25 °C, rise what the largest current would reach in the end. Copper and no regulation: size = 0.0039 rise / K.
    """
    del rng
    schedule = scene.schedule
    measured = (schedule.coil_temperature_C - 25.0) / schedule.steady_rise_K
    warming = measured if schedule.has_temperature else schedule.coil_warming
    truth = Truth(
        "coil1",
        (
            Known("steady_drop", size, "1"),
            Known("per_kelvin", size / schedule.steady_rise_K, "1/K"),
            Known("warming_time_s", schedule.warming_time_s, "s"),
        ),
    )
    return replace(scene, current_A=scene.current_A / (1.0 + size * warming)), truth


CAUSES = (
    Cause("current_gain", Stage.SUPPLY, "1", 0.05, current_gain),
    Cause("current_offset", Stage.SUPPLY, "A", 0.2, current_offset),
    Cause("coil_heating", Stage.SUPPLY, "1", 0.1, coil_heating),
)

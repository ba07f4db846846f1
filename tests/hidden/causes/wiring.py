"""Flaws of the current's way: what flows is not what was commanded, and it reaches the sensor's wires."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.causes.surroundings import vector
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.scene import Scene

SEVERAL_CURRENTS = ("recommended",)


def soft_limit(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The supply yields under load: of the largest current the share `size` is missing, and with the cube of the current less below."""
    del rng
    largest_A = np.abs(scene.schedule.current_A).max()
    missing = size * (scene.current_A / largest_A) ** 2
    return replace(scene, current_A=scene.current_A * (1.0 - missing)), Truth(
        "coil1", (Known("missing", size, "1"),)
    )


def polarity_gain(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The two halves of a bipolar supply differ: negative currents are larger or smaller by the share `size`."""
    excess = sign(rng) * size
    factor = np.where(scene.current_A < 0.0, 1.0 + excess, 1.0)
    return replace(scene, current_A=factor * scene.current_A), Truth("coil1", (Known("excess", excess, "1"),))


def loose_connector(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Two to six times the connector loosens for 3 to 15 readings and a share `size` of the current takes another way."""
    n = len(scene.schedule)
    is_loose = np.zeros(n, dtype=bool)
    for _ in range(int(rng.integers(2, 7))):
        begin = int(rng.integers(n - 15))
        is_loose[begin : begin + int(rng.integers(3, 16))] = True
    current_A = np.where(is_loose, 1.0 - size, 1.0) * scene.current_A
    return replace(scene, current_A=current_A), Truth("coil1", (Known("loss", size, "1"),))


def barkhausen_jumps(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A bad core jumps 4 to 12 times: the coil's strength takes a step of its own each time, normal with `size`, and keeps it."""
    jumps = np.zeros(len(scene.schedule))
    at = rng.choice(np.arange(5, len(jumps)), int(rng.integers(4, 13)), replace=False)
    jumps[at] = size * rng.normal(size=len(at))
    factor = 1.0 + np.cumsum(jumps)
    return replace(scene, current_A=factor * scene.current_A), Truth("coil1", (Known("sd", size, "1"),))


def current_crosstalk(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A common return wire: the coil's current adds to one sensor's voltages, `size` at the largest current, in a direction of its own."""
    is_its, name = afflicted_sensor(scene, rng)
    per_A = size * direction(rng) / np.abs(scene.schedule.current_A).max()
    added_T = (is_its * scene.current_A)[:, None] * per_A
    return replace(scene, field_T=scene.readings_T + added_T), Truth(name, vector("crosstalk", per_A, "T/A"))


CAUSES = (
    Cause("soft_limit", Stage.SUPPLY, "1", 0.1, soft_limit, protocols=SEVERAL_CURRENTS),
    Cause("polarity_gain", Stage.SUPPLY, "1", 0.05, polarity_gain, protocols=SEVERAL_CURRENTS),
    Cause("loose_connector", Stage.SUPPLY, "1", 0.2, loose_connector),
    Cause("barkhausen_jumps", Stage.SUPPLY, "1", 0.05, barkhausen_jumps),
    Cause(
        "current_crosstalk",
        Stage.SENSOR,
        "T",
        500e-6,
        current_crosstalk,
        freedom=3,
        protocols=SEVERAL_CURRENTS,
    ),
)

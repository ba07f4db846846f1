"""Flaws of movers that stand elsewhere from one instant on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.causes.surroundings import vector
from tests.hidden.flaw import Cause, Known, Stage, Truth, direction
from tests.hidden.scene import Scene


def mover_slipped(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Steps are lost, or the feet are pushed: from one instant on what carries the coil stands `size` beside what it says, as far everywhere."""
    time_s = scene.schedule.time_s
    instant_s = rng.uniform(0.25, 0.75) * time_s[-1]
    shift_m = size * direction(rng)
    true_m = scene.displacement_m + (time_s > instant_s)[:, None] * shift_m
    truth = Truth("arm1", (Known("instant_s", instant_s, "s"), *vector("shift", shift_m, "m")))
    return replace(scene, displacement_m=true_m), truth


# With one sensor it is the same as a bumped sensor, to the last digit.
CAUSES = (
    Cause("mover_slipped", Stage.ROBOT, "m", 1e-3, mover_slipped, freedom=4, protocols=("recommended",)),
)

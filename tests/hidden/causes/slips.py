"""Flaws of movers, supplies and rooms that begin in the session, some of which end in it; and of channels that share a converter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tests.hidden.causes.surroundings import vector, with_source
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction
from tests.hidden.scene import Scene


def mover_slipped(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Steps are lost, or the feet are pushed: from one instant on what carries the coil stands `size` beside what it says, as far everywhere."""
    time_s = scene.schedule.time_s
    instant_s = rng.uniform(0.25, 0.75) * time_s[-1]
    shift_m = size * direction(rng)
    true_m = scene.displacement_m + (time_s > instant_s)[:, None] * shift_m
    truth = Truth("arm1", (Known("instant_s", instant_s, "s"), *vector("shift", shift_m, "m")))
    return replace(scene, displacement_m=true_m), truth


def current_spell(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The supply is in another range for a while: the current is smaller by the share `size` meanwhile."""
    is_meanwhile, when = a_while(scene, rng)
    delivered_A = np.where(is_meanwhile, (1.0 - size) * scene.current_A, scene.current_A)
    return replace(scene, current_A=delivered_A), Truth("coil1", (*when, Known("loss", size, "1")))


def background_spell(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A trolley stands far off for a while: a uniform field of `size` is there meanwhile."""
    is_meanwhile, when = a_while(scene, rng)
    extra_T = is_meanwhile[:, None] * size * direction(rng)
    return with_source(scene, lambda *_: extra_T), Truth("room", (*when, Known("size", size, "T")))


def gain_spell(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A sensor's amplifier is in another range for a while: each axis shows another share more or less, `size` in all."""
    is_meanwhile, when = a_while(scene, rng)
    is_its, name = afflicted_sensor(scene, rng)
    excess = (is_meanwhile & is_its)[:, None] * size * direction(rng)
    return replace(scene, field_T=scene.readings_T * (1.0 + excess)), Truth(name, when)


def sign_spell(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The leads are exchanged for a while, and the record does not say so; less than size 1 is a share of that."""
    is_meanwhile, when = a_while(scene, rng)
    return replace(scene, current_A=np.where(is_meanwhile, 1.0 - 2.0 * size, 1.0) * scene.current_A), Truth(
        "coil1", when
    )


def channel_crosstalk(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Two sensors share a converter that keeps a share `size` of the channel it read before: of the reading before, if another sensor's."""
    is_its, name = afflicted_sensor(scene, rng)
    shown = scene.readings_T
    order = np.argsort(scene.schedule.time_s, kind="stable")
    before = np.empty(len(order), dtype=int)
    before[order[1:]], before[order[0]] = order[:-1], order[0]
    is_hit = is_its & (scene.schedule.sensor[before] != scene.schedule.sensor)
    mixed = np.where(is_hit[:, None], (1.0 - size) * shown + size * shown[before], shown)
    return replace(scene, field_T=mixed), Truth(name, (Known("share", size, "1"),))


def a_while(scene: Scene, rng: np.random.Generator) -> tuple[npt.NDArray[np.bool_], tuple[Known, Known]]:
    """Readings of a sixth to a third of the session, somewhere within it, and when that begins and ends."""
    time_s = scene.schedule.time_s
    share = rng.uniform(1.0 / 6.0, 1.0 / 3.0)
    begin_s = rng.uniform(0.15, 0.85 - share) * time_s[-1]
    end_s = begin_s + share * time_s[-1]
    is_meanwhile = (time_s > begin_s) & (time_s <= end_s)
    return is_meanwhile, (Known("begin_s", begin_s, "s"), Known("end_s", end_s, "s"))


# With one sensor it is the same as a bumped sensor, to the last digit.
CAUSES = (
    Cause("mover_slipped", Stage.ROBOT, "m", 1e-3, mover_slipped, freedom=4, protocols=("recommended",)),
    Cause("current_spell", Stage.SUPPLY, "1", 0.1, current_spell, freedom=3),
    Cause("background_spell", Stage.SURROUNDINGS, "T", 500e-6, background_spell, freedom=4),
    Cause("gain_spell", Stage.SENSOR, "1", 0.1, gain_spell, freedom=5),
    Cause("channel_crosstalk", Stage.SENSOR, "1", 0.1, channel_crosstalk, protocols=("recommended",)),
    Cause("current_sign_spell", Stage.SUPPLY, "1", 1.0, sign_spell, is_discrete=True),
)

"""Flaws of a room in which others work: trams pass, tools lie about, chairs are moved."""

from __future__ import annotations

import numpy as np

from tests.hidden.causes.surroundings import (
    dipole_field,
    induced_dipole,
    place_beyond_sensor,
    vector,
    with_source,
)
from tests.hidden.flaw import Cause, Known, Stage, Truth, direction
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene


def tram_walk(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Stray currents of trams: a uniform field walks at random along each axis, `size` its rms about its mean."""
    path = np.cumsum(rng.normal(size=(len(scene.schedule), 3)), axis=0)
    path -= path.mean(axis=0)
    walk_T = size * path / np.sqrt(np.mean(path**2))
    return with_source(scene, lambda *_: walk_T), Truth("room", (Known("rms_T", size, "T"),))


def tool_left(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A magnetised tool of moment `size` lies near the sensor for 10 to 40 % of the session and is taken away."""
    place_m, moment_A_m2 = place_beyond_sensor(rng), size * direction(rng)
    share, time_s = rng.uniform(0.1, 0.4), scene.schedule.time_s
    begin_s = rng.uniform(0.0, 1.0 - share) * time_s[-1]
    is_there = (time_s > begin_s) & (time_s <= begin_s + share * time_s[-1])

    def field(_: Scene, points_m: Array) -> Array:
        steady_T = dipole_field(points_m - place_m, np.broadcast_to(moment_A_m2, points_m.shape))
        return np.asarray(is_there[:, None] * steady_T)

    known = (Known("begin_s", begin_s, "s"), *vector("moment", moment_A_m2, "A m2"))
    return with_source(scene, field), Truth("room", (*known, *vector("position", place_m, "m")))


def chair_moved(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Soft iron (a sphere of cubed radius `size`) is moved in mid-session from one place near the sensor to another."""
    first_m, second_m = place_beyond_sensor(rng), place_beyond_sensor(rng)
    instant_s = rng.uniform(0.25, 0.75) * scene.schedule.time_s[-1]
    is_later = (scene.schedule.time_s > instant_s)[:, None]
    before, after = induced_dipole(first_m, size), induced_dipole(second_m, size)
    known = (
        Known("instant_s", instant_s, "s"),
        *vector("first", first_m, "m"),
        *vector("second", second_m, "m"),
    )
    moved = with_source(
        scene, lambda now, points_m: np.where(is_later, after(now, points_m), before(now, points_m))
    )
    return moved, Truth("room", known)


CAUSES = (
    Cause("tram_walk", Stage.SURROUNDINGS, "T", 300e-6, tram_walk),
    Cause("tool_left", Stage.SURROUNDINGS, "A m2", 2.0, tool_left, freedom=3),
    Cause("chair_moved", Stage.SURROUNDINGS, "m3", 2.7e-5, chair_moved, freedom=4),
)

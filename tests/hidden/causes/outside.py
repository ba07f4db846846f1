"""Flaws outside the library of the first study: there a diagnosis should say that something is left which it cannot explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.causes.surroundings import (
    dipole_field,
    induced_dipole,
    place_beyond_sensor,
    vector,
    with_source,
)
from tests.hidden.causes.winding import elliptic_field
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction
from tests.hidden.protocols import DWELL_S, Array
from tests.hidden.scene import Scene

OFFSET_SCALE_T = 5e-3  # offset of an exchanged sensor per unit of its change of gain


def eddy_lag(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Eddy currents in the table hold on to the past field: a share `size` of every change lingers and dies away over `decay_s`.

    In the sensor's frame E_k = (E_(k-1) + B_(k-1) - B_k) exp(-2 s / decay), shown = B + size x E. Each sensor remembers the field at its
    own place, also through the readings of the other.
    """
    decay_s = rng.uniform(1.0, 6.0)
    keep = np.exp(-DWELL_S / decay_s)
    scene_T = scene.readings_T
    lingering_T = np.zeros_like(scene_T)
    for which in range(len(scene.schedule.sensors)):
        is_its = scene.schedule.sensor == which
        everywhere = as_if_all_were(scene, which)
        state = np.zeros(3)
        for k in range(1, len(scene_T)):
            state = (state + everywhere[k - 1] - everywhere[k]) * keep
            lingering_T[k] = np.where(is_its[k], state, lingering_T[k])
    truth = Truth("room", (Known("share", size, "1"), Known("decay_s", decay_s, "s")))
    return replace(scene, field_T=scene_T + size * lingering_T), truth


def as_if_all_were(scene: Scene, which: int) -> Array:
    """Field that one sensor would have seen at all readings."""
    if len(scene.schedule.sensors) == 1:
        return scene.readings_T
    first = int(np.argmax(scene.schedule.sensor == which))
    alone = replace(
        scene,
        sensor_position_m=np.broadcast_to(scene.sensor_position_m[first], scene.sensor_position_m.shape),
        world_from_sensor=np.broadcast_to(scene.world_from_sensor[first], scene.world_from_sensor.shape),
    )
    return alone.measured().readings_T


def sheared_ellipse(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A crushed coil: elliptic loops (half axes a (1 ± size)) whose centres lean by 4 x size per height, along the longer axis."""
    angle_rad = rng.uniform(-np.pi, np.pi)
    known = (
        Known("ovality", size, "1"),
        Known("shear", 4.0 * size, "1"),
        Known("angle_rad", angle_rad, "rad"),
    )
    return replace(scene, coil_field=elliptic_field(scene, size, angle_rad, 4.0 * size)), Truth(
        "coil1", known
    )


def second_iron_body(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Two soft iron spheres of cubed radius `size` (m^3), at least 7 cm apart."""
    first_m, second_m = place_beyond_sensor(rng), place_beyond_sensor(rng)
    while np.linalg.norm(first_m - second_m) < 0.07:
        first_m, second_m = place_beyond_sensor(rng), place_beyond_sensor(rng)
    known = (
        Known("radius_m", np.cbrt(size), "m"),
        *vector("first", first_m, "m"),
        *vector("second", second_m, "m"),
    )
    both = with_source(with_source(scene, induced_dipole(first_m, size)), induced_dipole(second_m, size))
    return both, Truth("room", known)


def magnetised_link(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A steel part of the arm, 2 to 6 cm behind the coil and up to 8 cm beside its axis, is magnetised: a dipole that moves with the coil."""
    moment_A_m2 = size * direction(rng)
    behind_m = -scene.winding.length_m - rng.uniform(0.02, 0.06)
    beside_m = rng.uniform(0.03, 0.08) * np.array(
        [np.cos(angle := rng.uniform(-np.pi, np.pi)), np.sin(angle)]
    )
    offset_m = np.array([*beside_m, behind_m])

    def field(now: Scene, points_m: Array) -> Array:
        offset, moment = now.coil_rotation @ offset_m, np.broadcast_to(moment_A_m2, points_m.shape)
        if now.turn is not None:  # a part of the arm turns with it
            offset = now.from_coil_axes(np.broadcast_to(offset_m, points_m.shape))
            moment = now.from_coil_axes(moment)
        return dipole_field(points_m - (now.coil_origin_m() + offset), moment)

    known = (*vector("moment", moment_A_m2, "A m2"), *vector("offset_from_coil", offset_m, "m"))
    return with_source(scene, field), Truth("arm1", known)


def sensor_exchanged(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """At one instant a sensor is replaced: from then on it shows (1 + size G) B + size x 5 mT x o, G and o standard normal."""
    is_its, name = afflicted_sensor(scene, rng)
    instant_s = rng.uniform(0.3, 0.6) * scene.schedule.time_s[-1]
    gain, offset_T = np.eye(3) + size * rng.normal(size=(3, 3)), size * OFFSET_SCALE_T * rng.normal(size=3)
    is_new = is_its & (scene.schedule.time_s > instant_s)
    shown = np.where(is_new[:, None], scene.readings_T @ gain.T + offset_T, scene.readings_T)
    known = tuple(Known(f"gain_{i}{j}", gain[i, j], "1") for i in range(3) for j in range(3))
    return replace(scene, field_T=shown), Truth(
        name, (Known("instant_s", instant_s, "s"), *known, *vector("offset", offset_T, "T"))
    )


CAUSES = (
    Cause("eddy_lag", Stage.SENSOR, "1", 0.1, eddy_lag),
    Cause("sheared_ellipse", Stage.WINDING, "1", 0.05, sheared_ellipse),
    Cause("second_iron_body", Stage.SURROUNDINGS, "m3", 2.7e-5, second_iron_body),
    Cause("magnetised_link", Stage.SURROUNDINGS, "A m2", 2.0, magnetised_link),
    Cause("sensor_exchanged", Stage.SENSOR, "1", 0.05, sensor_exchanged),
)

"""Flaws of one sensor: what it shows is not the field along its axes. In the recommended protocol either of the two, at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.causes.surroundings import vector
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.scene import Scene

AXES = "xyz"
REFERENCE_FIELD_T = 10e-3  # sizes of the non-linear terms are relative, at this field
REFERENCE_C = 25.0


def axis_gain(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """One axis shows (1 + error) times its component."""
    is_its, name = afflicted_sensor(scene, rng)
    axis, error = int(rng.integers(3)), sign(rng) * size
    shown = scene.readings_T.copy()
    shown[is_its, axis] *= 1.0 + error
    return replace(scene, field_T=shown), Truth(name, (Known(f"gain_{AXES[axis]}", 1.0 + error, "1"),))


def cross_axis(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """One axis also sees another: shown B_i = B_i + cross_ij B_j, for one pair i, j of the six."""
    is_its, name = afflicted_sensor(scene, rng)
    i, j = rng.choice(3, 2, replace=False)
    cross = sign(rng) * size
    shown = scene.readings_T.copy()
    shown[is_its, i] += cross * scene.readings_T[is_its, j]
    return replace(scene, field_T=shown), Truth(name, (Known(f"cross_{AXES[i]}{AXES[j]}", cross, "1"),))


def element_displacement(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The y and the z element sit `size` from the x element, each in a direction of its own in the sensor's frame."""
    is_its, name = afflicted_sensor(scene, rng)
    y_m, z_m = size * direction(rng), size * direction(rng)
    offset_m = scene.element_offset_m.copy()
    offset_m[is_its, 1] += y_m
    offset_m[is_its, 2] += z_m
    return replace(scene, element_offset_m=offset_m), Truth(
        name, (*vector("y_element", y_m, "m"), *vector("z_element", z_m, "m"))
    )


def sensor_offset(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A steady offset of each component, in the sensor's frame."""
    is_its, name = afflicted_sensor(scene, rng)
    offset_T = size * direction(rng)
    return replace(scene, field_T=scene.readings_T + is_its[:, None] * offset_T), Truth(
        name, vector("offset", offset_T, "T")
    )


def offset_drift(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """An offset that grows evenly from 0 at the first reading to `size` at the last."""
    is_its, name = afflicted_sensor(scene, rng)
    since_s = scene.schedule.time_s - scene.schedule.time_s[0]
    rate_T_per_s = size * direction(rng) / since_s[-1]
    drift_T = (is_its * since_s)[:, None] * rate_T_per_s
    return replace(scene, field_T=scene.readings_T + drift_T), Truth(
        name, vector("rate", rate_T_per_s, "T/s")
    )


def cubic_response(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Each axis shows B + c B^3 of its own component, with the same c; `size` is c x (10 mT)^2."""
    is_its, name = afflicted_sensor(scene, rng)
    cubic_per_T2 = sign(rng) * size / REFERENCE_FIELD_T**2
    added = is_its[:, None] * cubic_per_T2 * scene.readings_T**3
    return replace(scene, field_T=scene.readings_T + added), Truth(
        name, (Known("cubic_per_T2", cubic_per_T2, "1/T2"),)
    )


def planar_hall(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Each axis also shows p x the product of the two other components, with the same p; `size` is p x 10 mT."""
    is_its, name = afflicted_sensor(scene, rng)
    planar_per_T = sign(rng) * size / REFERENCE_FIELD_T
    x, y, z = scene.readings_T.T
    added = is_its[:, None] * planar_per_T * np.stack([y * z, z * x, x * y], axis=1)
    return replace(scene, field_T=scene.readings_T + added), Truth(
        name, (Known("planar_per_T", planar_per_T, "1/T"),)
    )


def range_clipping(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Readings beyond ± range are shown as ± range; `size` is the share of the largest reading that is cut off."""
    is_its, name = afflicted_sensor(scene, rng)
    range_T = (1.0 - size) * float(np.abs(scene.readings_T[is_its]).max())
    shown = np.where(is_its[:, None], np.clip(scene.readings_T, -range_T, range_T), scene.readings_T)
    return replace(scene, field_T=shown), Truth(name, (Known("range_T", range_T, "T"),))


def temperature_drift(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The gain of all three axes is 1 + coefficient x (T - 25 °C), T as recorded; `size` is per kelvin."""
    is_its, name = afflicted_sensor(scene, rng)
    coefficient = sign(rng) * size
    warm_K = is_its * (scene.schedule.sensor_temperature_C - REFERENCE_C)
    shown = scene.readings_T * (1.0 + coefficient * warm_K)[:, None]
    return replace(scene, field_T=shown), Truth(name, (Known("gain_per_K", coefficient, "1/K"),))


def outliers(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A share `size` of the readings shows one component off by 8 to 50 times the noise."""
    n = len(scene.readings_T)
    is_hit = np.argsort(rng.random(n)) < round(size * n)
    error = rng.uniform(8.0, 50.0, n) * rng.choice((-1.0, 1.0), n)
    added = np.zeros_like(scene.readings_T)
    added[np.arange(n), rng.integers(3, size=n)] = is_hit * error * scene.sigma_T[:, 0]
    return replace(scene, field_T=scene.readings_T + added), Truth("readings", (Known("share", size, "1"),))


CAUSES = (
    Cause("axis_gain", Stage.SENSOR, "1", 0.05, axis_gain, freedom=3),
    Cause("cross_axis", Stage.SENSOR, "1", 0.05, cross_axis, freedom=6),
    Cause("element_displacement", Stage.ROBOT, "m", 1e-3, element_displacement, freedom=6),
    Cause("sensor_offset", Stage.SENSOR, "T", 500e-6, sensor_offset, freedom=3),
    Cause("offset_drift", Stage.SENSOR, "T", 200e-6, offset_drift, freedom=3),
    Cause("cubic_response", Stage.SENSOR, "1", 0.05, cubic_response),
    Cause("planar_hall", Stage.SENSOR, "1", 0.05, planar_hall),
    Cause("range_clipping", Stage.READOUT, "1", 0.6, range_clipping),
    Cause("temperature_drift", Stage.SENSOR, "1/K", 5e-3, temperature_drift, protocols=("recommended",)),
    Cause("outliers", Stage.SENSOR, "1", 0.1, outliers, is_random=True),
)

"""Flaws that show in the order of the readings: steps, waves and memories of current, room and sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.causes.outside import as_if_all_were
from tests.hidden.causes.sensor import REFERENCE_C
from tests.hidden.causes.surroundings import vector, with_source
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.protocols import DWELL_S, Array
from tests.hidden.scene import Scene


def current_step(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """From one instant on the current is smaller by the share `size`: turns are shorted, or the supply changed its range."""
    instant_s = rng.uniform(0.2, 0.8) * scene.schedule.time_s[-1]
    factor = np.where(scene.schedule.time_s > instant_s, 1.0 - size, 1.0)
    known = (Known("loss", size, "1"), Known("instant_s", instant_s, "s"))
    return replace(scene, current_A=factor * scene.current_A), Truth("coil1", known)


def current_remanence(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A core remembers: a share `size` of the last extreme current, from which it turned back, still acts."""
    del rng
    kept_A = last_extreme(scene.schedule.current_A)
    return replace(scene, current_A=scene.current_A + size * kept_A), Truth(
        "coil1", (Known("share", size, "1"),)
    )


def last_extreme(values: Array) -> Array:
    """The last turning point of a sequence that began at 0, before every entry; 0 where it never turned."""
    extreme, rising, before = 0.0, 0.0, 0.0
    memory = np.zeros(len(values))
    for k, value in enumerate(values):
        step = np.sign(value - before)
        if step != 0.0:
            if step == -rising:
                extreme = before
            rising = step
        memory[k], before = extreme, value
    return memory


def periodic_interference(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A machine nearby: a uniform field swings as a sine, its period between a third of a dwell (aliased) and half the session."""
    time_s = scene.schedule.time_s
    period_s = float(np.exp(rng.uniform(np.log(DWELL_S / 3.0), np.log(0.5 * time_s[-1]))))
    amplitude_T, phase_rad = size * direction(rng), rng.uniform(-np.pi, np.pi)
    wave_T = np.sin(2.0 * np.pi * time_s / period_s + phase_rad)[:, None] * amplitude_T
    known = (Known("period_s", period_s, "s"), Known("phase_rad", phase_rad, "rad"))
    return with_source(scene, lambda *_: wave_T), Truth(
        "room", (*known, *vector("amplitude", amplitude_T, "T"))
    )


def sensor_lag(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A filter of first order: shown_k = B_k + (shown_(k-1) - B_k) `size`, size = exp(-dwell / tau), from 0 s on without a past.

    The sensor follows the field at its own place at all times, also while the other is read.
    """
    is_its, name = afflicted_sensor(scene, rng)
    which = int(scene.schedule.sensor[np.argmax(is_its)])
    shown = as_if_all_were(scene, which).copy()
    for k in range(1, len(shown)):
        shown[k] += size * (shown[k - 1] - shown[k])
    tau_s = -DWELL_S / np.log(size) if size > 0.0 else 0.0
    return replace(scene, field_T=np.where(is_its[:, None], shown, scene.readings_T)), Truth(
        name, (Known("tau_s", tau_s, "s"),)
    )


def thermal_lag(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The gain follows the sensor's recorded temperature, but late: 1 + size x (T late - 25 °C), of first order in 1 to 10 minutes."""
    is_its, name = afflicted_sensor(scene, rng)
    coefficient, tau_s = sign(rng) * size, float(np.exp(rng.uniform(np.log(60.0), np.log(600.0))))
    late_C = scene.schedule.sensor_temperature_C.copy()
    for k in range(1, len(late_C)):
        late_C[k] += (late_C[k - 1] - late_C[k]) * np.exp(-DWELL_S / tau_s)
    gain = 1.0 + coefficient * is_its * (late_C - REFERENCE_C)
    known = (Known("gain_per_K", coefficient, "1/K"), Known("tau_s", tau_s, "s"))
    return replace(scene, field_T=scene.readings_T * gain[:, None]), Truth(name, known)


CAUSES = (
    Cause("current_step", Stage.SUPPLY, "1", 0.1, current_step, freedom=2),
    Cause("current_remanence", Stage.SUPPLY, "1", 0.1, current_remanence, protocols=("recommended",)),
    Cause("periodic_interference", Stage.SURROUNDINGS, "T", 500e-6, periodic_interference, freedom=6),
    Cause("sensor_lag", Stage.SENSOR, "1", 0.5, sensor_lag),
    Cause("thermal_lag", Stage.SENSOR, "1/K", 5e-3, thermal_lag, freedom=2, protocols=("recommended",)),
)

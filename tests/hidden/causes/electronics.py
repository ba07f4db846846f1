"""Flaws behind one sensor's elements: conversion, timing, memory and the direction of the field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.causes.outside import as_if_all_were
from tests.hidden.causes.sensor import AXES
from tests.hidden.causes.surroundings import vector
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.scene import Scene

LATE_SHARE = 0.1  # of the readings
FLIPPING_T = 2e-3


def adc_ripple(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Integral nonlinearity of the converter: each axis is off by a sine of its own component, of period 1 to 8 mT."""
    is_its, name = afflicted_sensor(scene, rng)
    period_T, phase_rad = rng.uniform(1e-3, 8e-3), rng.uniform(-np.pi, np.pi, 3)
    ripple_T = size * is_its[:, None] * np.sin(2.0 * np.pi * scene.readings_T / period_T + phase_rad)
    known = (Known("amplitude_T", size, "T"), Known("period_T", period_T, "T"))
    return replace(scene, field_T=scene.readings_T + ripple_T), Truth(name, known)


def adc_carry(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Missing codes at a major carry: above a level in its middle one axis reads `size` more, all the way up."""
    is_its, name = afflicted_sensor(scene, rng)
    axis, share = int(rng.integers(3)), rng.uniform(0.25, 0.75)
    level_T = float(np.quantile(scene.readings_T[is_its, axis], share))
    shown = scene.readings_T.copy()
    shown[:, axis] += size * (is_its & (shown[:, axis] > level_T))
    known = (Known(f"step_{AXES[axis]}_T", size, "T"), Known("level_T", level_T, "T"))
    return replace(scene, field_T=shown), Truth(name, known)


def late_trigger(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """At a tenth of the readings averaging began before the move had ended: a share `size` is of the field before."""
    is_late = rng.random(len(scene.schedule)) < LATE_SHARE
    is_late[0] = False
    mixed = scene.readings_T.copy()
    for which in range(len(scene.schedule.sensors)):
        is_hit = is_late & (scene.schedule.sensor == which)
        own = as_if_all_were(scene, which)
        mixed[is_hit] += size * (np.roll(own, 1, axis=0) - own)[is_hit]
    return replace(scene, field_T=mixed), Truth("readings", (Known("share", size, "1"),))


def offset_memory(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Each axis keeps an offset of the sign of the last strong component that it saw (2 mT and more); it begins at none."""
    is_its, name = afflicted_sensor(scene, rng)
    own = as_if_all_were(scene, int(scene.schedule.sensor[np.argmax(is_its)]))
    sides = np.where(np.abs(own) > FLIPPING_T, np.sign(own), 0.0)
    last = np.maximum.accumulate(np.where(sides != 0.0, np.arange(len(own))[:, None], 0), axis=0)
    memory_T = size * np.take_along_axis(sides, last, axis=0)
    return replace(scene, field_T=scene.readings_T + is_its[:, None] * memory_T), Truth(
        name, (Known("offset_T", size, "T"),)
    )


def directional_gain(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The gain of all axes depends on the field's direction u: 1 + size x (u d)^4 about an axis d of the element's plate."""
    is_its, name = afflicted_sensor(scene, rng)
    axis, excess = direction(rng), sign(rng) * size
    length_T = np.linalg.norm(scene.readings_T, axis=1)
    cosine = scene.readings_T @ axis / np.where(length_T > 0.0, length_T, 1.0)
    gain = 1.0 + is_its * excess * cosine**4
    known = (Known("excess", excess, "1"), *vector("axis", axis, "1"))
    return replace(scene, field_T=gain[:, None] * scene.readings_T), Truth(name, known)


CAUSES = (
    Cause("adc_ripple", Stage.SENSOR, "T", 300e-6, adc_ripple),
    Cause("adc_carry", Stage.SENSOR, "T", 500e-6, adc_carry),
    Cause("late_trigger", Stage.SENSOR, "1", 0.3, late_trigger),
    Cause("offset_memory", Stage.SENSOR, "T", 500e-6, offset_memory),
    Cause("directional_gain", Stage.SENSOR, "1", 0.1, directional_gain, freedom=3),
)

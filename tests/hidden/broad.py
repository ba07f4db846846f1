"""Causes as broadly as a library may fit them: with numbers of their own for every axis, and those that this generator never hides.

They only answer what another cause could imitate. A gain of one axis looks like a shift of that axis' element, which the hidden
`element_displacement` leaves in place; whoever fits all three elements may call it so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.hidden.causes.sensor import REFERENCE_C, REFERENCE_FIELD_T
from tests.hidden.causes.surroundings import dipole_field
from tests.hidden.coil import CoilField
from tests.hidden.flaw import Cause, Stage, Truth, afflicted_sensor
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene

DRIFT_T = 20e-3  # what the zero may drift per unit of the gain's drift


def every_element(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """All three elements sit elsewhere."""
    is_its, name = afflicted_sensor(scene, rng)
    offset_m = scene.element_offset_m + is_its[:, None, None] * size * rng.normal(size=(3, 3))
    return replace(scene, element_offset_m=offset_m), Truth(name, ())


def every_axis_bends(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A cubic term for each axis."""
    is_its, name = afflicted_sensor(scene, rng)
    cubic = size * rng.normal(size=3) / REFERENCE_FIELD_T**2
    return replace(scene, field_T=scene.readings_T + is_its[:, None] * cubic * scene.readings_T**3), Truth(
        name, ()
    )


def every_axis_mixes(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A product of the two others for each axis."""
    is_its, name = afflicted_sensor(scene, rng)
    x, y, z = scene.readings_T.T
    planar = size * rng.normal(size=3) / REFERENCE_FIELD_T
    added = is_its[:, None] * planar * np.stack([y * z, z * x, x * y], axis=1)
    return replace(scene, field_T=scene.readings_T + added), Truth(name, ())


def gain_and_zero_warm(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Gain and zero follow the recorded temperature."""
    is_its, name = afflicted_sensor(scene, rng)
    warm_K = (is_its * (scene.schedule.sensor_temperature_C - REFERENCE_C))[:, None]
    gain, zero_T = size * rng.normal(), size * DRIFT_T * rng.normal(size=3)
    return replace(scene, field_T=scene.readings_T * (1.0 + gain * warm_K) + warm_K * zero_T), Truth(name, ())


def iron_core(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Iron in the bore: a dipole in the winding's middle."""
    del rng
    before, core = scene.coil_field, _dipole_of(scene)
    return replace(scene, coil_field=lambda points_m: before(points_m) + size * core(points_m)), Truth(
        "coil1", ()
    )


def core_saturation(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """That iron answers less and less to the current."""
    core, largest_A = _dipole_of(scene), np.abs(scene.schedule.current_A).max()
    share, loss = size * rng.normal(size=2)

    def field(now: Scene, points_m: Array) -> Array:
        answer_A = now.current_A * (share - loss * (now.current_A / largest_A) ** 2)
        return np.asarray(answer_A[:, None] * now.from_coil_axes(core(now.in_coil_frame(points_m))))

    return replace(scene, sources=(*scene.sources, field)), Truth("coil1", ())


def dipole_model(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The winding is a dipole."""
    del rng
    before, point = scene.coil_field, _dipole_of(scene)
    field = replace(
        scene, coil_field=lambda points_m: (1.0 - size) * before(points_m) + size * point(points_m)
    )
    return field, Truth("coil1", ())


def _dipole_of(scene: Scene) -> CoilField:
    """Field per ampere of a dipole with the winding's moment."""
    w = scene.winding
    moment = np.array([0.0, 0.0, w.axial_loops * np.pi * (w.radii_m**2).sum()])
    middle_m = np.array([0.0, 0.0, -0.5 * w.length_m])
    return lambda points_m: dipole_field(points_m - middle_m, np.broadcast_to(moment, points_m.shape))


BROAD = {
    cause.name: cause
    for cause in (
        Cause("element_displacement", Stage.ROBOT, "m", 1e-3, every_element, freedom=9),
        Cause("cubic_response", Stage.SENSOR, "1", 0.05, every_axis_bends, freedom=3),
        Cause("planar_hall", Stage.SENSOR, "1", 0.05, every_axis_mixes, freedom=3),
        Cause(
            "temperature_drift",
            Stage.SENSOR,
            "1/K",
            5e-3,
            gain_and_zero_warm,
            freedom=4,
            protocols=("recommended",),
        ),
        Cause("iron_core", Stage.WINDING, "1", 0.3, iron_core),
        Cause("core_saturation", Stage.SURROUNDINGS, "1", 0.3, core_saturation, freedom=2),
        Cause("dipole_model", Stage.WINDING, "1", 1.0, dipole_model),
    )
}

"""Flaws of the record: what was measured is written down under another axis, unit, sign or frame. They are there or not."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.causes.surroundings import vector
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor
from tests.hidden.protocols import MOTIONS
from tests.hidden.scene import Scene

# Recorded = true quantity x factor: the column says T and A.
UNIT_ERRORS = (("field", 1e3), ("field", 1e4), ("field", 1e-3), ("current", 1e3))


def signed_permutations() -> list[np.ndarray]:
    """The 48 matrices that swap and turn over axes; the first is the identity."""
    return [
        np.diag(signs)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]


def axes_swapped(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Components of one sensor are recorded as M B, M one of the 46 signed permutations other than +1 and -1 (the latter is a current's sign)."""
    is_its, name = afflicted_sensor(scene, rng)
    choices = [m for m in signed_permutations() if abs(np.trace(m)) < 3.0]
    matrix = choices[int(rng.integers(len(choices)))]
    if size == 0.0:
        matrix = np.eye(3)
    written = np.where(is_its[:, None], scene.readings_T @ matrix.T, scene.readings_T)
    known = tuple(Known(f"m_{i}{j}", matrix[i, j], "1") for i in range(3) for j in range(3))
    return replace(scene, field_T=written), Truth(name, known)


def unit_error(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Columns of the wrong unit: fields in mT or gauss under T, fields in T under mT, or currents in mA under A."""
    quantity, factor = UNIT_ERRORS[int(rng.integers(len(UNIT_ERRORS)))]
    factor = factor if size > 0.0 else 1.0
    truth = Truth("record", (Known(f"{quantity}_factor", factor, "1"),))
    if quantity == "field":
        return replace(scene, field_T=factor * scene.readings_T), truth
    return replace(scene, current_A=factor * scene.current_A), truth


def left_handed(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Displacements are recorded in a left-handed frame: one of the three has the wrong sign."""
    axis = int(rng.integers(3))
    factor = np.ones(3)
    factor[axis] = -1.0 if size > 0.0 else 1.0
    truth = Truth("arm1", vector("sign", factor, "1"))
    return replace(scene, displacement_m=scene.displacement_m * factor), truth


def displacement_frame(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Displacements are recorded in the robot's base frame: dt_base = base_from_flange0 dt, which the rotation vector gives.

    The tool points down (a half turn about x), turned about its own axis by 20 to 160 degrees either way.
    """
    spin = np.deg2rad(rng.uniform(20.0, 160.0)) * rng.choice((-1.0, 1.0))
    turn = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * Rotation.from_rotvec([0.0, 0.0, spin])
    if size == 0.0:
        turn = Rotation.identity()
    truth = Truth("arm1", vector("base_from_flange0", turn.as_rotvec(), "rad"))
    return replace(scene, displacement_m=turn.apply(scene.displacement_m)), truth


def current_sign(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The leads are the wrong way round: the recorded current is minus the delivered one."""
    del rng
    factor = -1.0 if size > 0.0 else 1.0
    return replace(scene, current_A=factor * scene.current_A), Truth("coil1", (Known("sign", factor, "1"),))


CAUSES = tuple(
    Cause(apply.__name__, Stage.RECORD, "1", 1.0, apply, is_discrete=True, motions=motions)
    for apply, motions in (
        (axes_swapped, MOTIONS),
        (unit_error, MOTIONS),
        (left_handed, ("displacement",)),
        (displacement_frame, ("displacement",)),
        (current_sign, MOTIONS),
    )
)

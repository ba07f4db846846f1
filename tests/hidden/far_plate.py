"""A first session beside a steel plate that stands so far off that the coil's own numbers absorb its image. Loops by magpylib."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.independent.readings import coil_field_T

CASE = Path(__file__).parents[1] / "fixtures/first_calibration"
COIL = {"radius_m": 0.0402, "wire_radius_m": 0.41e-3, "axial_loops": 30, "radial_loops": 12, "current_A": 1.0}
FRONT_M = np.array([0.3e-3, -0.4e-3, -30e-3])
NOISE_T = 15e-6
MIRRORED = np.array([1.0, 1.0, -1.0])


def write_far_plate(folder: Path, behind_m: float, rng: np.random.Generator) -> None:
    """The rig file and the readings of `fixtures/first_calibration`, with a perfect plate behind the coil and no field of the room.

    Args:
        folder: Holds both afterwards.
        behind_m: From the front face of the coil to the plate.
        rng: Of the noise.
    References: Jackson, Classical Electrodynamics, section 5.12 with problem 5.17 (images in a highly permeable half space).
    """

    def coil_and_image_T(points_m: np.ndarray) -> np.ndarray:
        image_T = -MIRRORED * coil_field_T(points_m * MIRRORED - [0.0, 0.0, 2.0 * behind_m], **COIL)
        return np.asarray(coil_field_T(points_m, **COIL) + image_T)

    write_session(folder, coil_and_image_T, 1.0, rng)


def write_session(
    folder: Path, field_T_per_A: Callable[[np.ndarray], np.ndarray], amperes: float, rng: np.random.Generator
) -> None:
    """Readings at the places of `fixtures/first_calibration`, with its rig file.

    Args:
        folder: Holds both afterwards.
        field_T_per_A: At points in the coil's frame.
        amperes: Factor on the currents.
        rng: Of the noise.
    """
    given = np.genfromtxt(CASE / "readings.csv", delimiter=",", names=True)
    stage_m = 1e-2 * np.stack([given[f"stage_{axis}_cm"] for axis in "xyz"], axis=1)
    current_A = amperes * given["coil1_current_A"]
    field_T = current_A[:, None] * field_T_per_A(stage_m - FRONT_M)
    field_T += rng.normal(scale=NOISE_T, size=field_T.shape)
    rows = np.column_stack([given["t_s"], stage_m, current_A, field_T])
    header = "t_s,stage_x_m,stage_y_m,stage_z_m,coil1_current_A,Bx_T,By_T,Bz_T"
    np.savetxt(folder / "readings.csv", rows, "%.7g", ",", header=header, comments="")
    (folder / "rig.yaml").write_text((CASE / "rig.yaml").read_text(encoding="utf-8"), encoding="utf-8")

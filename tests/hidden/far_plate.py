"""A first session beside a steel plate that stands so far off that the coil's own numbers absorb its image. Loops by magpylib."""

from __future__ import annotations

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
    given = np.genfromtxt(CASE / "readings.csv", delimiter=",", names=True)
    stage_m = 1e-2 * np.stack([given[f"stage_{axis}_cm"] for axis in "xyz"], axis=1)
    points_m, current_A = stage_m - FRONT_M, given["coil1_current_A"]
    image_T = -MIRRORED * coil_field_T(points_m * MIRRORED - [0.0, 0.0, 2.0 * behind_m], **COIL)
    field_T = current_A[:, None] * (coil_field_T(points_m, **COIL) + image_T)
    field_T += rng.normal(scale=NOISE_T, size=field_T.shape)
    rows = np.column_stack([given["t_s"], stage_m, current_A, field_T])
    header = "t_s,stage_x_m,stage_y_m,stage_z_m,coil1_current_A,Bx_T,By_T,Bz_T"
    np.savetxt(folder / "readings.csv", rows, "%.7g", ",", header=header, comments="")
    (folder / "rig.yaml").write_text((CASE / "rig.yaml").read_text(encoding="utf-8"), encoding="utf-8")

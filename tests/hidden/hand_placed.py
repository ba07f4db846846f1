"""A first session in which a hand puts the probe at marks, each time a little off, and reads it at several currents. Loops by magpylib."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.hidden.far_plate import CASE, COIL, FRONT_M, NOISE_T
from tests.independent.readings import coil_field_T

CURRENTS_A = (1.0, 2.0, -2.0)
MARKS_M = np.array(
    [[x, y, z] for z in (0.0, 0.02, 0.04) for y in (-0.02, 0.0, 0.02) for x in (-0.02, 0.0, 0.02)]
)


def write_hand_placed(folder: Path, scatter_m: float, rng: np.random.Generator) -> None:
    """The rig file of `fixtures/first_calibration` and readings at marks, each of which the probe misses by an error of its own.

    Args:
        folder: Holds both afterwards.
        scatter_m: Of each coordinate of a placement.
        rng: Of placements and noise.
    """
    placed_m = MARKS_M + rng.normal(scale=scatter_m, size=MARKS_M.shape)
    per_A_T = coil_field_T(placed_m - FRONT_M, **COIL)
    rows = [
        [mark_m, current_A, current_A * field_T]
        for mark_m, field_T in zip(MARKS_M, per_A_T, strict=True)
        for current_A in CURRENTS_A
    ]
    table = np.array(
        [[5.0 * i, *at_m, current_A, *field_T] for i, (at_m, current_A, field_T) in enumerate(rows)]
    )
    table[:, 5:] += rng.normal(scale=NOISE_T, size=(len(table), 3))
    header = "t_s,stage_x_m,stage_y_m,stage_z_m,coil1_current_A,Bx_T,By_T,Bz_T"
    np.savetxt(folder / "readings.csv", table, "%.9g", ",", header=header, comments="")
    (folder / "rig.yaml").write_text((CASE / "rig.yaml").read_text(encoding="utf-8"), encoding="utf-8")

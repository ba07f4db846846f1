"""A first session beside a ball of iron far larger than a tool: a vice, or a corner of a rack. Loops by magpylib."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.hidden.far_plate import CASE, COIL, FRONT_M, NOISE_T
from tests.independent.readings import coil_field_T


def write_large_iron(
    folder: Path, ball_m: np.ndarray, radius_m: float, amperes: float, rng: np.random.Generator
) -> None:
    """The rig file and the readings of `fixtures/first_calibration` at larger currents, with a ball and no field of the room.

    Args:
        folder: Holds both afterwards.
        ball_m: Middle of the ball in the coil's frame.
        radius_m: Of the ball.
        amperes: Factor on the currents.
        rng: Of the noise.
    References: Jackson, Classical Electrodynamics, section 5.11 (a ball of high permeability in a field).
    """
    given = np.genfromtxt(CASE / "readings.csv", delimiter=",", names=True)
    stage_m = 1e-2 * np.stack([given[f"stage_{axis}_cm"] for axis in "xyz"], axis=1)
    points_m, current_A = stage_m - FRONT_M, amperes * given["coil1_current_A"]
    at_ball_T = coil_field_T(ball_m[None], **COIL)[0]
    away_m = points_m - ball_m
    distance_m = np.linalg.norm(away_m, axis=1, keepdims=True)
    towards = away_m / distance_m
    ball_T = (3.0 * towards * (towards @ at_ball_T)[:, None] - at_ball_T) * (radius_m / distance_m) ** 3
    field_T = current_A[:, None] * (coil_field_T(points_m, **COIL) + ball_T)
    field_T += rng.normal(scale=NOISE_T, size=field_T.shape)
    rows = np.column_stack([given["t_s"], stage_m, current_A, field_T])
    header = "t_s,stage_x_m,stage_y_m,stage_z_m,coil1_current_A,Bx_T,By_T,Bz_T"
    np.savetxt(folder / "readings.csv", rows, "%.7g", ",", header=header, comments="")
    (folder / "rig.yaml").write_text((CASE / "rig.yaml").read_text(encoding="utf-8"), encoding="utf-8")

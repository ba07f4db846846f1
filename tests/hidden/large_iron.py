"""A first session beside a ball of iron far larger than a tool: a vice, or a corner of a rack. Loops by magpylib."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.hidden.far_plate import COIL, write_session
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
    at_ball_T = coil_field_T(ball_m[None], **COIL)[0]

    def coil_and_ball_T(points_m: np.ndarray) -> np.ndarray:
        away_m = points_m - ball_m
        distance_m = np.linalg.norm(away_m, axis=1, keepdims=True)
        towards = away_m / distance_m
        ball_T = (3.0 * towards * (towards @ at_ball_T)[:, None] - at_ball_T) * (radius_m / distance_m) ** 3
        return np.asarray(coil_field_T(points_m, **COIL) + ball_T)

    write_session(folder, coil_and_ball_T, amperes, rng)

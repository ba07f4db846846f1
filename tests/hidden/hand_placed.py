"""A first session in which a hand puts the probe at marks, each time a little off, and reads it at several currents. Loops by magpylib."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.hidden.far_plate import CASE, COIL, FRONT_M, NOISE_T
from tests.independent.readings import coil_field_T

FIRST_M, LAST_M = np.array([-0.022, -0.022, -0.005]), np.array([0.022, 0.022, 0.035])  # of the marks


class Hand(NamedTuple):
    """Marks and currents of a session, and the standard deviation of each coordinate of a placement."""

    marks_m: np.ndarray
    currents_A: tuple[float, ...]
    scatter_m: float


def draw_hand(rng: np.random.Generator) -> Hand:
    """Nine to sixty marks, two to five currents, and a placement to 0.2 to 1.5 mm."""
    marks_m = np.round(rng.uniform(FIRST_M, LAST_M, size=(int(rng.integers(9, 61)), 3)), 3)
    currents_A = ((1.0, 2.0, -2.0), (0.5, 1.5), (0.0, 1.0, 2.0), (-2.0, -1.0, 1.0, 2.0, 3.0))[rng.integers(4)]
    return Hand(marks_m, currents_A, float(np.exp(rng.uniform(np.log(2e-4), np.log(1.5e-3)))))


def write_hand_placed(folder: Path, hand: Hand, rng: np.random.Generator, is_shared: bool = True) -> None:
    """The rig file of `fixtures/first_calibration`, and readings at marks that the probe misses.

    Args:
        folder: Holds both afterwards.
        hand: Marks, currents and placement.
        rng: Of placements and noise.
        is_shared: Whether all readings of a mark share one placement; else the probe is put there for each anew.
    """
    mark = np.repeat(np.arange(len(hand.marks_m)), len(hand.currents_A))
    current_A = np.tile(hand.currents_A, len(hand.marks_m))
    off_m = rng.normal(scale=hand.scatter_m, size=(len(mark), 3))
    placed_m = hand.marks_m[mark] + (off_m[np.searchsorted(mark, mark)] if is_shared else off_m)
    field_T = current_A[:, None] * coil_field_T(placed_m - FRONT_M, **COIL)
    field_T += rng.normal(scale=NOISE_T, size=field_T.shape)
    table = np.column_stack([5.0 * np.arange(len(mark)), hand.marks_m[mark], current_A, field_T])
    header = "t_s,stage_x_m,stage_y_m,stage_z_m,coil1_current_A,Bx_T,By_T,Bz_T"
    np.savetxt(folder / "readings.csv", table, "%.9g", ",", header=header, comments="")
    (folder / "rig.yaml").write_text((CASE / "rig.yaml").read_text(encoding="utf-8"), encoding="utf-8")

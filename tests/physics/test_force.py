"""The force between two loops, by Maxwell's mutual inductance, by dipoles far away, by Newton's third law and by magpylib."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
import torch
from scipy.special import ellipe, ellipk

from estimator.field.force import force_on_loop_N
from estimator.frames import Transform
from estimator.units import MU0_T_M_PER_A

RADIUS_M, OTHER_M = 0.038, 0.03
ASKEW = ([0.07, -0.03, 0.05], [0.9, -0.5, 0.3])


def force_N(middle_m: list[float], turn_rad: list[float], radius_m: float, other_m: float) -> np.ndarray:
    """Force on the first loop by one at a pose in its frame, an ampere in each."""
    pose = Transform.from_pose(*(torch.tensor([each], dtype=torch.float64) for each in (middle_m, turn_rad)))
    radii = (torch.tensor(each, dtype=torch.float64) for each in (radius_m, other_m))
    return force_on_loop_N((pose.translation_m, pose.rotation), *radii)[0].numpy()


def mutual_inductance_H(distance_m: float) -> float:
    """Of the coaxial loops (Maxwell 1873, art. 701)."""
    m = 4.0 * RADIUS_M * OTHER_M / ((RADIUS_M + OTHER_M) ** 2 + distance_m**2)
    k = np.sqrt(m)
    return float(
        MU0_T_M_PER_A * np.sqrt(RADIUS_M * OTHER_M) * ((2.0 / k - k) * ellipk(m) - 2.0 / k * ellipe(m))
    )


@pytest.mark.parametrize("distance_m", [0.02, 0.1, -0.06])
def test_coaxial_loops_pull_as_their_mutual_inductance_grows(distance_m):
    step_m = 1e-5
    slope = (mutual_inductance_H(distance_m + step_m) - mutual_inductance_H(distance_m - step_m)) / (
        2.0 * step_m
    )
    on_axis = force_N([0.0, 0.0, distance_m], [0.0, 0.0, 0.0], RADIUS_M, OTHER_M)
    # The force on the other loop is the slope of the inductance in its place; that on this one is the opposite.
    assert on_axis == pytest.approx([0.0, 0.0, -slope], rel=1e-6, abs=1e-15)


def test_what_one_loop_feels_the_other_feels_the_other_way_round():
    seen = Transform.from_pose(*(torch.tensor([each], dtype=torch.float64) for each in ASKEW))
    back = seen.inverse()
    on_first = force_N(*ASKEW, RADIUS_M, OTHER_M)
    radii = (torch.tensor(each, dtype=torch.float64) for each in (OTHER_M, RADIUS_M))
    on_other = force_on_loop_N((back.translation_m, back.rotation), *radii)
    assert seen.rotate(on_other)[0].numpy() == pytest.approx(-on_first, rel=1e-9)


def test_far_away_the_force_is_that_of_two_dipoles():
    middle_m, turn_rad = [0.8, -0.5, 0.6], ASKEW[1]
    moments = (
        np.pi * RADIUS_M**2 * np.array([0.0, 0.0, 1.0]),
        np.pi
        * OTHER_M**2
        * (
            Transform.from_pose(torch.zeros(1, 3, dtype=torch.float64), torch.tensor([turn_rad]).double())
            .rotation[0, :, 2]
            .numpy()
        ),
    )
    r = -np.array(middle_m)  # from the other to this one
    distance, unit = np.linalg.norm(r), r / np.linalg.norm(r)
    (m1, m2), (along1, along2) = moments, (moment @ unit for moment in moments)
    wanted = (3.0 * MU0_T_M_PER_A / (4.0 * np.pi * distance**4)) * (
        along2 * m1 + along1 * m2 + (m1 @ m2) * unit - 5.0 * along1 * along2 * unit
    )
    assert force_N(middle_m, turn_rad, RADIUS_M, OTHER_M) == pytest.approx(
        wanted, abs=0.02 * np.abs(wanted).max()
    )


def test_magpylib_says_the_same_of_loops_that_stand_askew():
    middle_m, turn_rad = ASKEW
    first = magpylib.current.Circle(diameter=2.0 * RADIUS_M, current=1.0)
    other = magpylib.current.Circle(diameter=2.0 * OTHER_M, current=1.0, position=middle_m)
    other.rotate_from_rotvec(turn_rad, degrees=False)
    wanted_N, _ = magpylib.getFT(other, first, meshing=500)
    assert force_N(*ASKEW, RADIUS_M, OTHER_M) == pytest.approx(
        np.squeeze(wanted_N), abs=1e-3 * np.abs(wanted_N).max()
    )

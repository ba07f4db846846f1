"""A system in machine code against the one of tensors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.rig_files.read import rig_from_text
from estimator.system.system import System
from tests.estimator.export.compared import assert_close
from tests.estimator.export.conftest import MAGNET, MOTION, calibration_of

NEAR_M = torch.from_numpy(np.random.default_rng(1).uniform(-0.03, 0.03, (6, 3)))
INSIDE_M = torch.tensor([[0.1, 0.0, 0.038]], dtype=torch.float64)
CURRENT_A = np.array([3.0, -2.0, 5.0])


@pytest.fixture(scope="module")
def magnet() -> Calibration:
    return calibration_of(rig_from_text(MAGNET))


def test_field_gradient_and_actuation_are_those_of_tensors(magnet):
    system = System.of(magnet)
    compiled = system.compiled()
    assert (compiled.coils, compiled.movers) == (system.coils, ("arm", "stage"))
    motion = np.stack([MOTION[name].numpy() for name in compiled.movers])
    points_m = torch.cat((NEAR_M, INSIDE_M))
    field_T, gradient = compiled.field_and_gradient(points_m.numpy(), CURRENT_A, motion)
    here = system.at(points_m, MOTION)
    assert_close(field_T, here.field_T(torch.from_numpy(CURRENT_A)))
    assert_close(gradient.reshape(-1, 9), here.gradient_T_per_m(torch.from_numpy(CURRENT_A)))
    matrix = compiled.actuation(points_m.numpy(), motion)
    assert_close(matrix[:, :3].reshape(-1, 9), here.actuation(has_gradient=False))
    assert_close(matrix[:, 3:].reshape(-1, 15), here.actuation()[:, 3:])


def test_each_point_may_have_poses_of_its_own(magnet):
    compiled = System.of(magnet).compiled()
    motion = np.stack([MOTION[name].numpy() for name in compiled.movers])
    motions = motion + np.random.default_rng(2).normal(scale=0.1, size=(len(NEAR_M), 2, 6))
    together_T, _ = compiled.field_and_gradient(NEAR_M.numpy(), CURRENT_A, motions)
    for i in range(len(NEAR_M)):
        alone_T, _ = compiled.field_and_gradient(NEAR_M[i : i + 1].numpy(), CURRENT_A, motions[i])
        np.testing.assert_array_equal(together_T[i], alone_T[0])


def test_coils_of_several_calibrations_add_up(magnet):
    """One coil each; the background counts once, and a supply that takes its neighbour's current has none in another calibration."""
    other = calibration_of(rig_from_text(MAGNET.replace("x_mm: 90", "x_mm: 95")))
    system = System({"standing": other, "shifted": magnet})
    field_T, _ = system.compiled().field_and_gradient(
        NEAR_M.numpy(), CURRENT_A[:2], MOTION["stage"].numpy()[None]
    )
    assert_close(field_T, system.at(NEAR_M, MOTION).field_T(torch.from_numpy(CURRENT_A[:2])))


def test_arrays_of_another_shape_are_refused(magnet):
    compiled = System.of(magnet).compiled()
    with pytest.raises(
        InvalidInput, match=r"motion \(2, 6\) or \(n, 2, 6\); received \(6, 3\) and \(3, 2, 6\)"
    ):
        compiled.field_and_gradient(NEAR_M.numpy(), CURRENT_A, np.zeros((3, 2, 6)))
    with pytest.raises(InvalidInput, match=r"one for each of 3 coils; received shape \(2,\)"):
        compiled.field_and_gradient(NEAR_M.numpy(), CURRENT_A[:2])

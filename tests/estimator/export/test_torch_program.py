"""The program of torch.export, run by a process that has no coilcal, against the calibration that it came from."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.export.magnet import Magnet
from estimator.export.torch_program import DESCRIPTION, MagnetProgram
from tests.estimator.export.compared import Question

pytestmark = pytest.mark.whole  # checks of shapes would be traced, too
PROGRAM = f"""
import sys
import numpy as np
import torch

texts = {{"{DESCRIPTION}": ""}}
magnet = torch.export.load("magnet.pt2", extra_files=texts).module()
given = {{key: torch.from_numpy(value) for key, value in np.load("given.npz").items()}}
field_T, gradient = magnet(given["points_m"], given["currents_A"], given["motion"])
one_T, _ = magnet(given["points_m"][:1], given["currents_A"], given["motion"])
points_m = given["points_m"][:3].clone().requires_grad_(True)
total = magnet(points_m, given["currents_A"], given["motion"])[0].sum()
slope, = torch.autograd.grad(total, points_m)
np.savez("found.npz", field_T=field_T, gradient=gradient, one_T=one_T, slope=slope)
assert "estimator" not in sys.modules
print(texts["{DESCRIPTION}"])
"""


@pytest.fixture(scope="module")
def answers(
    magnet: Calibration, question: Question, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, np.ndarray]:
    """What the other process finds, and what the program says of itself."""
    folder: Path = tmp_path_factory.mktemp("torch")
    path = magnet.export("torch", folder / "magnet.pt2")
    assert str(Path(__file__).parents[3]).encode() not in path.read_bytes()  # no paths of this computer
    currents_A, motion = list(question.currents_A.values()), torch.stack(list(question.motion.values()))
    np.savez(folder / "given.npz", points_m=question.points_m, currents_A=currents_A, motion=motion)
    command = [sys.executable, "-W", "error", "-c", PROGRAM]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env={})
    assert ran.returncode == 0, ran.stderr
    assert "of carried, standing, shifted" in ran.stdout
    return dict(np.load(folder / "found.npz"))


def test_field_and_gradient_are_those_of_predict(answers, magnet, question):
    question.check(np.concatenate((answers["field_T"], answers["gradient"].reshape(-1, 9)), axis=1), magnet)


def test_one_point_will_do_and_it_can_be_differentiated(answers):
    np.testing.assert_allclose(answers["one_T"], answers["field_T"][:1], rtol=1e-13)
    np.testing.assert_allclose(answers["slope"], answers["gradient"][:3].sum(1), rtol=1e-8)


def test_derivatives_in_poses_are_those_of_finite_steps(magnet, motion):
    program = MagnetProgram(Magnet.of(magnet).model("torch"))
    points_m, currents_A = torch.tensor([[0.01, 0.0, -0.01]]).double(), torch.tensor([1.0, 2.0, 3.0]).double()
    rows = torch.stack((motion["arm"], motion["stage"])).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda m: 1e3 * program(points_m, currents_A, m)[0], rows)

"""The function for MATLAB, run by Octave, against the calibration that it came from."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.system.actuation import independent_entries
from tests.estimator.export.compared import assert_close, by_octave, needs_octave

PROGRAM = """
points_m = dlmread("points.txt");
motion = dlmread("motion.txt");
[b, g, a] = magnet(points_m, [3 -2 5], motion);
n = size(points_m, 1);
printed = [b, reshape(permute(g, [1 3 2]), n, 9), reshape(permute(a, [1 3 2]), n, 24), magnet(points_m, [0 0 0])];
try
  magnet(points_m, [0 0 0], zeros(1, 6));
  error("not refused");
catch refusal
  assert(strcmp(refusal.message, "motion must be 2 x 6: a row for each mover that carries a coil; received 1 x 6"), refusal.message);
end
printf([repmat("%.17g ", 1, size(printed, 2)), "\\n"], printed');
"""


@needs_octave
def test_octave_finds_field_gradient_and_actuation_of_predict(
    magnet: Calibration,
    motion: dict[str, Tensor],
    currents_A: dict[str, float],
    points_m: Tensor,
    tmp_path: Path,
) -> None:
    magnet.export("matlab", tmp_path / "magnet.m")
    motions = torch.stack((motion["arm"], motion["stage"])).numpy()
    rows = by_octave(tmp_path, PROGRAM, {"points": points_m.numpy(), "motion": motions})
    field_T, gradient = (
        magnet.field(points_m, currents_A, motion),
        magnet.gradient(points_m, currents_A, motion),
    )
    assert_close(rows[:, :3], field_T)
    assert_close(rows[:, 3:12], gradient)
    matrix = torch.from_numpy(rows[:, 12:36].reshape(-1, 8, 3))
    made = matrix @ torch.tensor(list(currents_A.values())).double()
    assert_close((made[:, :3] + magnet.field(points_m, {}, motion)).numpy(), field_T)
    off = independent_entries(magnet.gradient(points_m, {}, motion))
    assert_close((made[:, 3:] + off).numpy(), independent_entries(gradient))
    assert_close(
        rows[:, 36:], magnet.field(points_m, {}, {"arm": torch.zeros(6).double()})
    )  # no motion is zeros


def test_name_that_matlab_does_not_take_is_refused(magnet: Calibration, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="received '3coils'"):
        magnet.export("matlab", tmp_path / "3coils.m")
    with pytest.raises(InvalidInput, match="inside it; received 'pose_of'"):
        magnet.export("matlab", tmp_path / "pose_of.m")

"""The function for MATLAB, run by Octave, against the calibration that it came from."""

from __future__ import annotations

import pytest
import torch

from estimator.errors import InvalidInput
from tests.estimator.export.compared import assert_close, needs_octave

AT_REST = """
printed = [printed, magnet(points_m, [0 0 0])];
try
  magnet(points_m, [0 0 0], zeros(1, 6));
  error("not refused");
catch refusal
  assert(strcmp(refusal.message, "motion must be 2 x 6: a row for each mover that carries a coil; received 1 x 6"), refusal.message);
end
"""


@needs_octave
def test_octave_finds_field_gradient_and_actuation_of_predict(magnet, question, tmp_path):
    rows = question.by_octave(magnet, tmp_path, AT_REST)
    question.check(rows, magnet)
    at_zeros = {"arm": torch.zeros(6).double()}  # no motion is zeros
    assert_close(rows[:, 36:], magnet.field(question.points_m, {}, at_zeros))


def test_name_that_matlab_does_not_take_is_refused(magnet, tmp_path):
    with pytest.raises(InvalidInput, match="received '3coils'"):
        magnet.export("matlab", tmp_path / "3coils.m")
    with pytest.raises(InvalidInput, match="inside it; received 'pose_of'"):
        magnet.export("matlab", tmp_path / "pose_of.m")

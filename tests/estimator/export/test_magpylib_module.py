"""The module that makes a magpylib collection, run, against the full sum over loops."""

from __future__ import annotations

import runpy
from dataclasses import replace

import pytest

from estimator.errors import InvalidInput
from estimator.model.room_field import RoomField
from tests.estimator.export.compared import assert_close


def test_collection_has_the_field_of_all_loops(magnet, question, tmp_path):
    outside_m, best = question.points_m[:-1], magnet.best_values()
    path = magnet.export("magpylib", tmp_path / "magnet.py", motion=question.motion)
    collection = runpy.run_path(str(path))["magnet"](list(question.currents_A.values()))
    whole = RoomField(magnet.rig, best, outside_m, question.motion, tolerance=0.0)
    expected_T = whole.field_T(best, magnet.currents(question.currents_A))
    assert_close(collection.getB(outside_m.numpy()), expected_T)


def test_mover_without_a_pose_and_loops_that_are_not_whole_are_refused(magnet, motion, tmp_path):
    with pytest.raises(InvalidInput, match="motion of arm must be given"):
        magnet.export("magpylib", tmp_path / "magnet.py")
    best = {**magnet.best, "standing.axial_loops": 10.5}
    with pytest.raises(InvalidInput, match=r"standing.axial_loops is 10\.5"):
        replace(magnet, best=best).export("magpylib", tmp_path / "magnet.py", motion=motion)

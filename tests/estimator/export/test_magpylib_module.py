"""The module that makes a magpylib collection, run, against the full sum over loops."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path

import pytest
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.model.room_field import RoomField
from tests.estimator.export.compared import assert_close


def test_collection_has_the_field_of_all_loops(
    magnet: Calibration,
    motion: dict[str, Tensor],
    currents_A: dict[str, float],
    points_m: Tensor,
    tmp_path: Path,
) -> None:
    outside_m = points_m[:-1]
    path = magnet.export("magpylib", tmp_path / "magnet.py", motion=motion)
    collection = runpy.run_path(str(path))["magnet"](list(currents_A.values()))
    whole = RoomField(magnet.rig, magnet.best_values(), outside_m, motion, tolerance=0.0)
    assert_close(
        collection.getB(outside_m.numpy()), whole.field_T(magnet.best_values(), magnet.currents(currents_A))
    )


def test_mover_without_a_pose_and_loops_that_are_not_whole_are_refused(
    magnet: Calibration, motion: dict[str, Tensor], tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match="motion of arm must be given"):
        magnet.export("magpylib", tmp_path / "magnet.py")
    best = {**magnet.best, "standing.axial_loops": 10.5}
    with pytest.raises(InvalidInput, match=r"standing.axial_loops is 10\.5"):
        replace(magnet, best=best).export("magpylib", tmp_path / "magnet.py", motion=motion)

"""Sides, corners, wire and loops other than stated: loops of magpylib with the real numbers have the same field."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
import torch

from estimator.effects import EFFECTS
from estimator.model.room_field import RoomField
from estimator.rig.coordinates import nominal_tensors
from estimator.rig_files.read import rig_from_text
from tests.estimator.field.test_sided import MAGPYLIB_OVER_OURS, outline

RIG = """
schema_version: 1
name: a coil with straight sides
coils:
  coil1: {{model: {model}, inner_side_x_mm: 60, inner_side_y_mm: 40, {corner} wire_radius_mm: 0.5, axial_loops: 4, radial_loops: 2}}
sensors: {{hall: {{noise_uT: 5}}}}
effects:
  sides_misstated[coil1]: {{side_x: 0.05, side_y: -0.1, corner: {by}, wire: 0.2, axial_loops: 0.5, radial_loops: 0.5}}
"""
POINTS_M = np.array([[0.0, 0.0, 0.02], [0.02, -0.015, 0.025], [0.06, 0.01, -0.003], [-0.01, 0.05, 0.004]])


@pytest.mark.parametrize(
    ("model", "corner", "by", "radius_m"),
    [("rectangular", "", 0.0, 0.0), ("racetrack", "inner_corner_radius_mm: 10,", 0.3, 0.013)],
)
def test_it_is_the_field_of_the_real_loops(model, corner, by, radius_m):
    rig = rig_from_text(RIG.format(model=model, corner=corner, by=by))
    points_m = torch.from_numpy(POINTS_M)
    room = RoomField(rig, nominal_tensors(rig), points_m, {}, tolerance=0.0)
    found_T = room.field_T(nominal_tensors(rig), torch.ones(1, dtype=torch.float64)).numpy()
    pitch_m, expected_T = 1.2e-3, np.zeros_like(POINTS_M)
    for i in range(6):
        for j in range(3):
            out_m = pitch_m * (j + 0.5)
            flat = outline(
                0.0315 + out_m, 0.018 + out_m, radius_m + out_m if radius_m else 0.0, 400 if radius_m else 1
            )
            wire = np.column_stack((flat, np.full(len(flat), -pitch_m * (i + 0.5))))
            expected_T += (
                magpylib.current.Polyline(vertices=wire, current=1.0).getB(POINTS_M) / MAGPYLIB_OVER_OURS
            )
    bound = 1e-5 if radius_m else 1e-9  # 400 chords for each corner
    np.testing.assert_allclose(found_T, expected_T, rtol=0.0, atol=bound * np.abs(expected_T).max())


def test_its_place_is_a_coil_with_straight_sides_alone():
    text = RIG.format(model="rectangular", corner="", by=0.0).partition("effects:")[0]
    round_one = "  coil2: {radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 4, radial_loops: 2}\nsensors:"
    rig = rig_from_text(text.replace("sensors:", round_one))
    assert EFFECTS["sides_misstated"].places(rig) == ("coil1",)
    assert EFFECTS["winding_misstated"].places(rig) == ("coil2",)

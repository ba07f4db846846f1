"""Coils with straight sides in rig files: what is read, written back, told and refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from estimator.cli.main import main
from estimator.rig.bodies import SidedCoil
from estimator.rig_files.read import load_rig, rig_from_text
from tests.estimator.rig_files.test_write import check_same

CONFIG = Path(__file__).parents[3] / "configs/rectangular_helmholtz.yaml"
TEXT = """\
schema_version: 1
name: two shapes
movers: {arm: {motion: pose}}
coils:
  c1:
    model: rectangular
    carried_by: arm
    inner_side_x_mm: {prior: {normal: {mean: 60, sd: 1}}}
    inner_side_y_cm: 4
    wire_radius_mm: 0.5
    axial_loops: 10
    radial_loops: 4
    flange_from_coil: {z_mm: 30}
  c2:
    model: racetrack
    inner_side_x_mm: 60
    inner_side_y_mm: 40
    inner_corner_radius_mm: {tied_to: c2.inner_side_y_m, factor: 0.5}
    axial_pitch_mm: 1.1
    radial_pitch_mm: 1.2
    axial_loops: {prior: {normal: {mean: 10, sd: 1, lower: 1}}}
    radial_loops: 4
sensors: {hall: {noise_uT: 5}}
"""


def test_numbers_and_ties_are_read_in_si():
    rig = rig_from_text(TEXT)
    assert rig.coils == (SidedCoil("c1", "arm", False), SidedCoil("c2", None, True))
    assert (rig.wound, rig.round, rig.unwound) == (rig.coils, (), ())
    values = rig.nominal_values()
    assert values["c1.inner_side_y_m"] == 0.04
    assert values["c1.axial_pitch_m"] == 1e-3
    assert values["c2.inner_corner_radius_m"] == 0.02
    assert "c1.inner_corner_radius_m" not in values
    assert [p.name for p in rig.free] == ["c1.inner_side_x_m", "c2.axial_loops"]


@pytest.mark.parametrize("text", [TEXT, CONFIG.read_text(encoding="utf-8")], ids=["shapes", "config"])
def test_it_comes_back_to_the_last_digit(text):
    check_same(rig_from_text(text))


def test_sharp_and_round_corners_are_different_rigs():
    sharp = TEXT.replace("model: racetrack", "model: rectangular").replace(
        "    inner_corner_radius_mm: {tied_to: c2.inner_side_y_m, factor: 0.5}\n", ""
    )
    assert rig_from_text(sharp).hash != rig_from_text(TEXT).hash


REFUSALS = {
    "no side": ("inner_side_y_cm: 4", "inner_side_y_cm: 0", 9, "coils.c1.inner_side_y_cm must be > 0; received 0"),
    "missing side": ("    inner_side_y_mm: 40\n", "", 15, "coils.c2.inner_side_y_m is missing"),
    "corner of a rectangle": ("inner_side_y_cm: 4", "inner_side_y_cm: 4\n    inner_corner_radius_mm: 2", 10,
        "coils.c1.inner_corner_radius_mm must not be given for a coil of model rectangular, which has "
        "straight sides and sharp"),
    "radius of a racetrack": ("    inner_side_x_mm: 60\n", "    inner_side_x_mm: 60\n    radius_mm: 30\n", 17,
        "coils.c2.radius_mm must not be given for a coil of model racetrack, which has straight sides"),
    "sides of a circle": ("    model: racetrack\n", "", 15,
        "coils.c2.inner_side_x_mm must not be given for a coil of model winding, whose loops are circles"),
    "large corner": ("{tied_to: c2.inner_side_y_m, factor: 0.5}", "21", 18,
        "coils.c2.inner_corner_radius_mm must be at most half the shorter side, 20 mm; received 21 mm"),
    "superconducting": ("axial_pitch_mm: 1.1\n", "superconducting: true\n", 19, "superconducting must not be given"),
    "many loops": ("axial_loops: 10\n", "axial_loops: 100000\n", 11, "coils.c1.axial_loops must be at most 5000"),
}  # fmt: skip


def test_check_says_what_it_understood():
    result = CliRunner().invoke(main, ["check", str(CONFIG)])
    assert result.exit_code == 0
    assert "winding about a bore of 160 mm x 120 mm with sharp corners, 10 x 8 loops" in result.output
    assert load_rig(CONFIG).wound == load_rig(CONFIG).coils

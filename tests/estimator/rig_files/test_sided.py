"""Coils with straight sides in rig files: what is read, written back, told and refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from estimator.cli.main import main
from estimator.errors import InvalidInput
from estimator.rig.bodies import SidedCoil
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.write import rig_text

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


def test_numbers_and_ties_are_read_in_si() -> None:
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
def test_it_comes_back_to_the_last_digit(text: str) -> None:
    rig = rig_from_text(text)
    again = rig_from_text(rig_text(rig))
    assert again == rig
    assert again.hash == rig.hash


def test_sharp_and_round_corners_are_different_rigs() -> None:
    sharp = TEXT.replace("model: racetrack", "model: rectangular").replace(
        "    inner_corner_radius_mm: {tied_to: c2.inner_side_y_m, factor: 0.5}\n", ""
    )
    assert rig_from_text(sharp).hash != rig_from_text(TEXT).hash


@pytest.mark.parametrize(
    ("old", "new", "message", "line"),
    [
        ("inner_side_y_cm: 4", "inner_side_y_cm: 0", "coils.c1.inner_side_y_cm must be > 0; received 0", 9),
        ("    inner_side_y_mm: 40\n", "", "coils.c2.inner_side_y_m is missing", 15),
        (
            "inner_side_y_cm: 4",
            "inner_side_y_cm: 4\n    inner_corner_radius_mm: 2",
            "coils.c1.inner_corner_radius_mm must not be given for a coil of model rectangular, which has straight sides and sharp",
            10,
        ),
        (
            "    inner_side_x_mm: 60\n",
            "    inner_side_x_mm: 60\n    radius_mm: 30\n",
            "coils.c2.radius_mm must not be given for a coil of model racetrack, which has straight sides",
            17,
        ),
        (
            "    model: racetrack\n",
            "",
            "coils.c2.inner_side_x_mm must not be given for a coil of model winding, whose loops are circles",
            15,
        ),
        (
            "{tied_to: c2.inner_side_y_m, factor: 0.5}",
            "21",
            "coils.c2.inner_corner_radius_mm must be at most half the shorter side, 20 mm; received 21 mm",
            18,
        ),
        ("axial_pitch_mm: 1.1\n", "superconducting: true\n", "superconducting must not be given", 19),
        ("axial_loops: 10\n", "axial_loops: 100000\n", "coils.c1.axial_loops must be at most 5000", 11),
    ],
)
def test_a_mistake_is_named_by_key_rule_value_and_line(old: str, new: str, message: str, line: int) -> None:
    assert TEXT.count(old) == 1
    with pytest.raises(InvalidInput) as caught:
        rig_from_text(TEXT.replace(old, new), "coils.yaml")
    assert message in str(caught.value)
    assert f"line {line}" in str(caught.value)


def test_check_says_what_it_understood() -> None:
    result = CliRunner().invoke(main, ["check", str(CONFIG)])
    assert result.exit_code == 0
    assert "winding about a bore of 160 mm x 120 mm with sharp corners, 10 x 8 loops" in result.output
    assert load_rig(CONFIG).wound == load_rig(CONFIG).coils

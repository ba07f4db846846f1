"""What all exports have in common: the table of formats, refusals, and the command."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.effects import EFFECTS
from estimator.errors import InvalidInput
from estimator.export.plain_model import plain_model
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

Calibrated = Callable[[Rig], Calibration]

PLATE = "strength: 0.3, axis: 2, tilt_1_rad: 0, tilt_2_rad: 0, distance_m: -0.3"


@pytest.mark.parametrize("to", ["json", "cpp"])
def test_model_that_a_format_cannot_express_is_refused_by_name(to, calibrated, corrected_rig, tmp_path):
    with pytest.raises(InvalidInput, match=r"no place for coil_harmonics\[coil1\] of rig 'small'"):
        calibrated(corrected_rig).export(to, tmp_path / "file")
    assert not list(tmp_path.iterdir())


def test_what_a_format_does_not_take_is_refused(magnet, tmp_path):
    with pytest.raises(InvalidInput, match="export to cpp must have no currents"):
        magnet.export("cpp", tmp_path / "file", currents_A={"carried": 1.0})
    with pytest.raises(InvalidInput, match="format must be one of json, cpp"):
        magnet.export("docx", tmp_path / "file")
    with pytest.raises(InvalidInput, match="output must be writable"):
        magnet.export("json", "/proc/none/file")


@pytest.mark.parametrize(
    ("effects", "named"),
    [
        (f"iron_plate[room]: {{{PLATE}}}", r"for iron_plate\[room\] of"),
        ("robot_scale[arm1]: {x: 0.01, y: 0, z: 0}", r"for robot_scale\[arm1\] of"),
        ("turns_gradient[coil1]: {slope: 0.01}", r"for turns_gradient\[coil1\] of"),
    ],
)
def test_effects_beyond_windings_and_poses_are_named(effects, named, rig_text):
    rig = rig_from_text(f"{rig_text}effects:\n  {effects}")
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    with pytest.raises(InvalidInput, match=named):
        plain_model(rig, values, "cpp")


def test_supply_that_is_not_linear_is_named(rig_text, monkeypatch):
    rig = rig_from_text(f"{rig_text}effects:\n  current_offset[coil1]: {{offset_A: 0.01}}")
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    plain_model(rig, values, "cpp")
    bent = staticmethod(lambda current_A, *_: current_A + 1e-3 * current_A**2)
    monkeypatch.setattr(type(EFFECTS["current_offset"]), "delivered", bent)
    with pytest.raises(InvalidInput, match=r"for current_offset\[coil1\] of"):
        plain_model(rig, values, "cpp")


def test_room_that_is_not_uniform_is_named(rig_text, monkeypatch):
    rig = rig_from_text(f"{rig_text}effects:\n  background_field[room]: {{x_T: 1e-5, y_T: 0, z_T: 0}}")
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    assert plain_model(rig, values, "cpp").background_T.tolist() == [1e-5, 0.0, 0.0]
    monkeypatch.setattr(
        type(EFFECTS["background_field"]), "steady_T", lambda _self, points_m, _theta: 1e-3 * points_m
    )
    with pytest.raises(InvalidInput, match=r"for background_field\[room\] of"):
        plain_model(rig, values, "cpp")

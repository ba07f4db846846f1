"""Leads of a coil in rig files, and their field beside that of the winding."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
import torch
from jsonschema import Draft202012Validator

from estimator.errors import InvalidInput
from estimator.export.plain_model import plain_model
from estimator.model.room_field import RoomField
from estimator.rig.bodies import Leads
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.schema import rig_schema
from estimator.rig_files.write import rig_text
from estimator.yaml_loader import Loader
from tests.estimator.field.test_sided import MAGPYLIB_OVER_OURS

TEXT = """\
schema_version: 1
name: leads
coils:
  c1:
    SHAPE
    wire_radius_mm: 0.5
    axial_loops: 4
    radial_loops: 2
    lead_in_mm: [[300, 5, -40], [60, 5, -2], [35, 0, -2]]
    lead_out_cm: [[3.5, 0, 0], [30, 0.5, 1]]
    world_from_coil: {x_mm: 10, rz_deg: 90}
sensors: {hall: {noise_uT: 5}}
"""
ROUND = TEXT.replace("SHAPE", "radius_mm: 30")
SIDED = TEXT.replace("SHAPE", "model: rectangular\n    inner_side_x_mm: 60\n    inner_side_y_mm: 40")
BOTH = pytest.mark.parametrize("text", [ROUND, SIDED], ids=["round", "rectangular"])


def without(text: str) -> Rig:
    return rig_from_text("".join(line for line in text.splitlines(keepends=True) if "lead_" not in line))


@BOTH
def test_they_come_back_to_the_last_digit_and_tell_rigs_apart(text):
    rig = rig_from_text(text)
    assert rig.wound[0].leads == Leads(
        ((0.3, 0.005, -0.04), (0.06, 0.005, -0.002), (0.035, 0.0, -0.002)),
        ((0.035, 0.0, 0.0), (0.3, 0.005, 0.01)),
    )
    assert rig_from_text(rig_text(rig)) == rig
    assert rig.hash != without(text).hash
    assert list(Draft202012Validator(rig_schema()).iter_errors(Loader(text, "rig").get_single_data())) == []


@BOTH
def test_their_field_is_that_of_wires_of_magpylib(text):
    points_m = torch.from_numpy(np.random.default_rng(0).uniform(0.05, 0.12, (20, 3)))
    current_A = torch.tensor([2.0], dtype=torch.float64)
    fields = [
        RoomField(rig, nominal_tensors(rig), points_m).field_T(nominal_tensors(rig), current_A).numpy()
        for rig in (rig_from_text(text), without(text))
    ]
    leads = rig_from_text(text).wound[0].leads
    assert leads is not None
    wires = magpylib.Collection(
        [magpylib.current.Polyline(current=2.0, vertices=path) for path in (leads.towards, leads.away)]
    )
    wires.rotate_from_angax(90.0, "z", anchor=(0.0, 0.0, 0.0)).move((0.01, 0.0, 0.0))
    expected_T = wires.getB(points_m.numpy()) / MAGPYLIB_OVER_OURS
    np.testing.assert_allclose(
        fields[0] - fields[1], expected_T, rtol=0.0, atol=3e-9 * np.abs(expected_T).max()
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[[3.5, 0, 0], [30, 0.5, 1]]", "[[3.5, 0, 0]]", "lead_out_cm must be a list of two points or more"),
        (
            "[[3.5, 0, 0], [30, 0.5, 1]]",
            "[[3.5, 0], [30, 0.5, 1]]",
            "lead_out_cm must be a list of two points",
        ),
        ("lead_in_mm", "lead_in", "lead_in must carry its unit"),
    ],
)
def test_a_path_of_another_form_is_refused(old, new, message):
    with pytest.raises(InvalidInput, match=message):
        rig_from_text(ROUND.replace(old, new))


def test_machine_code_for_round_windings_names_them():
    rig = rig_from_text(ROUND)
    with pytest.raises(InvalidInput, match=r"no place for c1 \(leads\)"):
        plain_model(rig, nominal_tensors(rig), "machine code", only_round=True)

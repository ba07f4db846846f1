"""Units are refused where all readings say so; wild readings are named, and what a cause explains is left to a diagnosis."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
import torch

from estimator.errors import InvalidInput
from estimator.frames import Transform, rotation_from_vector
from estimator.geometry.motion import base_from_motion
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import simulate
from estimator.model.unit_gate import check_units
from estimator.readings.observations import Observations
from estimator.readings.plan import load_plan
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rotations import vector_from_rotation

RIG = """
schema_version: 1
name: mapper
movers: {stage: {motion: pose}}
coils:
  coil1:
    radius_mm: {prior: {normal: {mean: 52, sd: 1}}}
    wire_radius_mm: 0.5
    axial_loops: 12
    radial_loops: 10
    world_from_coil: {z_mm: {prior: {normal: {mean: -40, sd: 2}}}}
sensors: {hall: {carried_by: stage, noise_uT: 10, flange_from_sensor: {z_mm: HOLDER}}}
"""
PLAN = """
schema_version: 1
name: plan
poses:
  calibration:
    stage: {x_mm: {from: -30, to: 30, count: 4}, y_mm: {from: -30, to: 30, count: 4}, z_mm: {from: 0, to: 20, count: 2},
            rx_deg: {from: -40, to: 50, count: 2}, ry_deg: {from: 30, to: 70, count: 2}}
currents_A: [{coil1: 3}]
"""


def rig(holder_mm: float = 0.0) -> Rig:
    return rig_from_text(RIG.replace("HOLDER", str(holder_mm)))


@pytest.fixture(scope="module")
def readings(tmp_path_factory: pytest.TempPathFactory) -> Observations:
    path = tmp_path_factory.mktemp("plan") / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return simulate(rig(), load_plan(path, rig()), {}, seed=0)


def with_row(observations: Observations, row: int, field_T: float | torch.Tensor) -> Observations:
    changed_T = observations.field_sensor_T.clone()
    changed_T[row] = field_T
    return observations.with_field(changed_T)


def test_readings_as_the_rig_describes_them_call_for_no_word(readings):
    assert check_units(rig(), readings, "a.csv") == []


def test_fields_in_the_frame_of_the_base_are_no_degrees(readings):
    world_from_sensor = rotation_from_vector(readings.motion["stage"][:, 3:])
    field_T = (world_from_sensor @ readings.field_sensor_T[..., None])[..., 0]
    (told,) = check_units(rig(), readings.with_field(field_T), "a.csv")
    assert told.startswith("Fields correlate with the rig's nominal model by 0.")
    far, others = check_units(rig(), with_row(readings.with_field(field_T), 5, 1.0), "a.csv")
    assert far.startswith("Reading 6: much farther")
    assert others.startswith("The other fields correlate with the rig's nominal model by 0.")


@pytest.mark.parametrize("holder_mm", [-30.0, 25.0, 60.0])
def test_a_sensor_that_sits_elsewhere_is_not_refused(readings, holder_mm):
    check_units(rig(holder_mm), readings, "a.csv")


def test_a_sensor_that_nominally_stands_in_the_winding_is_no_wrong_unit(readings):
    motion = readings.motion["stage"].clone()
    motion[3, :3] = torch.tensor([0.05, 0.0, -0.042])
    motion[3, 3:] = 0.0
    moved = replace(readings, motion={"stage": motion})
    (told,) = check_units(rig(), moved, "a.csv")
    assert told.startswith(
        "Units could not be compared with the rig's nominal model: sensors must lie outside the winding of coil1"
    )
    assert f"1 of {len(readings)} poses do not, the first at reading 3:" in told
    (told,) = check_units(rig(), replace(moved, line=torch.arange(len(readings)) + 2), "a.csv")
    assert "the first in line 5:" in told
    assert told.endswith("and coilcal diagnose looks for the cause (a.csv).")


@pytest.mark.parametrize("wild_T", [-0.26624, 9.999])
def test_a_few_wild_readings_are_named_and_not_the_unit(readings, wild_T):
    wild = with_row(with_row(readings, 7, wild_T), 11, wild_T)
    assert check_units(rig(), wild, "a.csv") == [
        "Readings 8, 12: much farther from the rig's nominal model than the others (a.csv)."
    ]


def test_places_beside_the_winding_that_are_a_little_off_are_not_wild(readings):
    """There the field is ten times that of most places, and 3 mm are a tenth of it; half of that field is another current."""
    near_m = torch.tensor([[0.0, 0.03, -0.025]]).double()
    motion = readings.motion["stage"].clone()
    motion[:, :3] = torch.where(torch.arange(len(motion))[:, None] % 16 == 0, near_m, motion[:, :3] + 0.05)
    motion[:, 3:] = 0.0
    there = replace(readings, motion={"stage": motion})
    offset = motion.clone()
    offset[:, 2] += 3e-3
    model = MeasurementModel.build(rig(), replace(there, motion={"stage": offset}))
    measured = there.with_field(model.predict(model.nominal))
    assert not [told for told in check_units(rig(), measured, "a.csv") if "farther" in told]
    halved = with_row(measured, 16, 0.5 * measured.field_sensor_T[16])
    told = check_units(rig(), halved, "a.csv")
    assert [each for each in told if each.startswith("Reading 17: much farther")]


def test_a_reversed_sign_is_told_and_left_to_the_diagnosis(readings):
    (told,) = check_units(rig(), replace(readings, current_A=-readings.current_A), "a.csv")
    assert "may be reversed" in told


@pytest.mark.parametrize(("factor", "is_told"), [(0.1, True), (0.5, False), (2.0, False), (10.0, True)])
def test_a_scale_that_a_rig_may_have_is_told(readings, factor, is_told):
    told = check_units(rig(), readings.with_field(factor * readings.field_sensor_T), "a.csv")
    assert [note.partition(" times those of")[0] for note in told] == [f"Fields are {factor:g}"] * is_told


def test_a_thousand_in_all_rows_is_refused_whatever_the_pattern(readings):
    shuffled = readings.field_sensor_T[
        torch.randperm(len(readings), generator=torch.Generator().manual_seed(0))
    ]
    check_units(rig(), readings.with_field(30.0 * shuffled.sign() * readings.field_sensor_T.abs()), "a.csv")
    with pytest.raises(InvalidInput, match="fields look like mT"):
        check_units(rig(), readings.with_field(1e3 * shuffled), "a.csv")


def test_poses_in_a_turned_frame_are_told_and_left_to_the_diagnosis():
    """The coil stands 30 cm beside the base: by the record the sensor is 60 cm from it, and fields are a thousand times too large."""
    away = rig_from_text(
        RIG.replace("HOLDER", "0").replace("world_from_coil: {", "world_from_coil: {x_mm: 300, ")
    )
    generator = torch.Generator().manual_seed(1)
    motion = 0.03 * torch.rand(30, 6, generator=generator, dtype=torch.float64)
    motion[:, 0] += 0.3
    motion[:, 3:] *= 20.0
    real = Observations.of(torch.full((30, 1), 3.0, dtype=torch.float64), {"stage": motion})
    model = MeasurementModel.build(away, real)
    half_turn = rotation_from_vector(torch.tensor([0.0, 0.0, torch.pi], dtype=torch.float64))
    turned = Transform(half_turn, torch.zeros(3).double()) @ base_from_motion(away.mover("stage"), motion)
    columns = torch.cat((turned.translation_m, vector_from_rotation(turned.rotation)), dim=1)
    recorded = replace(real, motion={"stage": columns}).with_field(model.predict(model.nominal))
    (told,) = check_units(away, recorded, "a.csv")
    assert "(pose_frame[stage]); coilcal diagnose looks for the cause" in told


def test_currents_without_their_sign_are_told(readings):
    """Both signs flowed, and the record holds sizes; where the record has the signs, nothing is said."""
    sign = torch.where(torch.arange(len(readings)) % 3 == 0, -1.0, 1.0).double()
    flowed = readings.with_field(sign[:, None] * readings.field_sensor_T)
    (told,) = check_units(rig(), flowed, "a.csv")
    assert re.search(
        r"in 3[234] % of the readings and along it in the others, and no current is negative", told
    )
    assert "currents may be recorded without their sign" in told
    assert check_units(rig(), replace(flowed, current_A=sign[:, None] * readings.current_A), "a.csv") == []
    (all_reversed,) = check_units(rig(), readings.with_field(-readings.field_sensor_T), "a.csv")
    assert "without their sign" not in all_reversed


def test_the_field_of_the_room_is_no_other_pattern(readings):
    """Half the readings without current, and a room whose field is larger than that of the coil."""
    is_idle = torch.arange(len(readings)) % 2 == 0
    field_T = readings.field_sensor_T.masked_fill(is_idle[:, None], 0.0) + torch.tensor([3e-3, -2e-3, 1e-3])
    current_A = readings.current_A.masked_fill(is_idle[:, None], 3e-4)  # as a meter shows it
    assert check_units(rig(), replace(readings.with_field(field_T), current_A=current_A), "a.csv") == []

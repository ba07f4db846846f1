"""Readings that a programme asks for are predicted where they would be taken."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.next_readings.turned import turned
from estimator.frames import Transform, rotation_from_vector
from estimator.geometry.motion import base_from_motion, world_from_body
from estimator.readings.observations import Observations
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

RIG = """
schema_version: 1
name: a probe on a stage
movers: {stage: {motion: displacement, FRAME}}
coils: {coil: {radius_mm: 50, wire_radius_mm: 0.5, axial_loops: 10, radial_loops: 10}}
sensors:
  hall:
    carried_by: stage
    noise_uT: 20
    world_from_sensor0: {z_mm: 40}
    flange_from_sensor: {x_mm: 30, rz_deg: 30, tilt_x_deg: 2}
"""
QUARTER = (0.5 * torch.pi, 0.0, 0.0)


def world_from_sensor(rig: Rig, readings: Observations) -> Transform:
    flange = {mover.name: base_from_motion(mover, readings.motion[mover.name]) for mover in rig.movers}
    return world_from_body(rig, rig.sensors[0], "sensor", flange, nominal_tensors(rig, readings.current_A))


@pytest.mark.parametrize("frame", ["", "displacement_frame: base, base_from_flange0: {ry_deg: 20}"])
def test_a_sensor_on_a_stage_is_turned_where_it_stands(frame):
    rig = rig_from_text(RIG.replace(", FRAME", frame and f", {frame}"))
    stage = {"stage": torch.tensor([[0.02, -0.01, 0.03, 0, 0, 0], [0, 0.04, 0.01, 0, 0, 0.1]]).double()}
    readings = Observations.of(torch.zeros(2, 1).double(), stage, torch.zeros(2, 3).double())
    before = world_from_sensor(rig, readings)
    turned_readings, turned_rig = turned(readings, rig, {"hall": QUARTER})
    after = world_from_sensor(turned_rig, turned_readings)
    torch.testing.assert_close(after.translation_m, before.translation_m)
    # The small tilt stays about the axes of the sensor.
    tilt = rotation_from_vector(torch.tensor([2.0, 0.0, 0.0]).double().deg2rad())
    quarter = rotation_from_vector(torch.tensor(QUARTER).double())
    torch.testing.assert_close(after.rotation, before.rotation @ tilt.mT @ quarter @ tilt)

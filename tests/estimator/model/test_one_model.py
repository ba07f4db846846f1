"""What a session is fitted with and what a prediction is made with are the same: an effect of every stage changes both alike."""

from __future__ import annotations

import pytest
import torch

from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import (
    CoreMagnetisation,
    CurrentEffect,
    MotionEffect,
    MountEffect,
    RecordEffect,
    RoomEffect,
    SourceEffect,
    WindingEffect,
    WindingMagnetisation,
)
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField
from estimator.readings.observations import Observations
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text

POINTS_M = ((0.0, 0.0, 0.02), (0.012, -0.021, 0.025), (-0.031, 0.017, 0.04), (0.058, 0.023, 0.01))
TEXT = """
schema_version: 1
name: probes that stand where the field is wanted
movers: {{arm: {{motion: displacement}}}}
coils:
  coil1:
    carried_by: arm
    radius_mm: 40
    wire_radius_mm: 0.5
    axial_loops: 6
    radial_loops: 4
    superconducting: true
    world_from_coil0: {{z_mm: -30, tilt_x_deg: 4}}
  coil2: {{radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3, world_from_coil: {{x_mm: 120, ry_deg: -90}}}}
sensors:
{sensors}
"""
SENSORS = "\n".join(
    f"  probe{i}: {{noise_uT: 1, world_from_sensor: {{x_mm: {1e3 * x}, y_mm: {1e3 * y}, z_mm: {1e3 * z}}}}}"
    for i, (x, y, z) in enumerate(POINTS_M)
)
MOTION = torch.tensor([0.004, -0.003, 0.005, 0.02, 0.01, -0.03], dtype=torch.float64)
CURRENT_A = torch.tensor([2.0, -1.5], dtype=torch.float64)
OF_THE_FIELD = (
    CurrentEffect,
    WindingEffect,
    SourceEffect,
    WindingMagnetisation,
    CoreMagnetisation,
    RoomEffect,
    MotionEffect,
    MountEffect,
    RecordEffect,
)


def moment() -> Observations:
    """All probes at once, at the first moment of a session."""
    n = len(POINTS_M)
    return Observations.of(
        CURRENT_A.expand(n, 2),
        {"arm": MOTION.expand(n, 6)},
        torch.full((n, 3), 1e-3, dtype=torch.float64),
        time_s=torch.zeros(n, dtype=torch.float64),
        sensor=torch.arange(n),
    )


def fitted_and_predicted(rig: Rig) -> tuple[torch.Tensor, torch.Tensor]:
    values = nominal_tensors(rig)
    readings_T = MeasurementModel.build(rig, moment(), tolerance=1e-12).predict(values)
    points_m = torch.tensor(POINTS_M, dtype=torch.float64)
    room = RoomField(rig, values, points_m, {"arm": MOTION}, tolerance=1e-12)
    return readings_T, room.field_T(values, CURRENT_A)


CAUSES = [
    Cause(name, place)
    for name, effect in EFFECTS.items()
    if isinstance(effect, OF_THE_FIELD)
    for place in effect.places(rig_from_text(TEXT.format(sensors=SENSORS)))[:1]
    if "probe" not in place
    # A prediction is of cold coils, which a session has warmed, of points, not of sensors, and lies in no segment of a session.
    and name not in ("coil_heating", "sensors_exchanged", "segment_misplaced")
]
NOT_AT_THE_FIRST_MOMENT = {
    "background_drift",
    "rows_shifted",
    "rows_shifted_since",
    "current_remanence",
    "periodic_interference",
    "position_lag",
    "backlash",
    "mover_slipped",
    "mover_spell",
    "current_spell",
    "current_sign_spell",
    "background_spell",
    "sensor_bumped",
    "room_wanders",
    "current_wanders",
    "current_swings",
    "guides_wander",
    "current_steps",
    "room_steps",
    "guides_step",
    "sides_remembered",
    "stop_errors",
    "moves_remembered",
}


def test_causes_of_every_stage_are_asked():
    assert {
        stage for stage in OF_THE_FIELD if any(isinstance(EFFECTS[c.name], stage) for c in CAUSES)
    } == set(OF_THE_FIELD)


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.label)
def test_an_effect_changes_fit_and_prediction_alike(cause):
    plain = rig_from_text(TEXT.format(sensors=SENSORS))
    observations, effect = moment(), EFFECTS[cause.name]
    circumstances = Circumstances(plain, observations)
    size = {
        q.key: q.null + 0.5 * q.prior.sd for q in effect.quantities(circumstances.extent) if not q.is_fixed
    }
    start = (effect.starts(circumstances, cause.place) or ({},))[-1]  # a moment has no spell
    if cause.name == "unit_error":
        start = {
            "field_factor": 1.0,
            "current_factor": 1e3,
        }  # a prediction is in tesla, whatever the record says
    if cause.name == "coil_pulled":
        size = {"compliance_m_per_N": 1.0}  # these coils pull with some micronewtons
    if cause.name == "current_range":
        start = {"below_A": 5.0}  # both coils are in it
    rig = with_effect(plain, cause, observations, {**size, **start}, is_free=False)
    before_T, _ = fitted_and_predicted(plain)
    readings_T, predicted_T = fitted_and_predicted(rig)
    scale_T = float(readings_T.abs().max())
    torch.testing.assert_close(readings_T, predicted_T, rtol=0.0, atol=1e-10 * scale_T)
    is_changed = float((readings_T - before_T).abs().max()) > 1e-6 * scale_T
    assert is_changed != (cause.name in NOT_AT_THE_FIRST_MOMENT)

"""The field of a running, simulated rig is that of the model, at the poses that its arms really stand at."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest
import torch

from drivers.protocols import FlangePose
from drivers.simulated.world import Snapshot
from estimator.errors import InvalidInput
from estimator.frames import vector_from_rotation
from estimator.geometry.motion import flange_to_reach, motion_reached
from estimator.model.simulate import perfect_readings
from estimator.model.simulated_field import SimulatedField, flange, simulated_rig
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig, rig_from_text

pytestmark = pytest.mark.whole

REFERENCE_K = 295.15
HOME = ((0.3, 0.1, 0.2), (0.4, 2.0, -0.3))
BASE_FRAME = """\
  arm1:
    motion: displacement
    displacement_frame: base
    base_from_flange0: {rx_rad: 0.4, ry_rad: 2.0, rz_rad: -0.3}
"""


def field_of(rig: Rig, hidden: dict[str, float] | None = None) -> SimulatedField:
    silent = {f"{sensor.name}.noise_T": 0.0 for sensor in rig.sensors}
    real = simulated_rig(rig, silent, hidden or {})
    homes = {mover.name: HOME for mover in rig.movers}
    return SimulatedField(real, rig.sensors[0].name, tuple(coil.name for coil in rig.coils), homes, 0)


def moment_of(rig: Rig, readings: Observations, row: int) -> Snapshot:
    """The world when the arms report what a row says."""
    poses = []
    for mover in rig.movers:
        there = flange_to_reach(mover, readings.motion[mover.name][row : row + 1], flange(HOME))
        vector = vector_from_rotation(there.rotation)[0]
        poses.append(FlangePose(tuple(there.translation_m[0].tolist()), tuple(vector.tolist())))
    coils_K = (REFERENCE_K,) * len(rig.coils)
    return Snapshot(0.0, tuple(readings.current_A[row].tolist()), tuple(poses), coils_K, REFERENCE_K)


def some_readings(rig: Rig) -> Observations:
    """Random small displacements, turned ones among them, or joint angles about a posture where the coils are apart."""
    generator = torch.Generator().manual_seed(5)
    motion = {}
    for mover in rig.movers:
        small = torch.rand(4, 6, generator=generator, dtype=torch.float64) - 0.5
        posture = torch.deg2rad(torch.tensor([0.0, -90.0, -90.0, 0.0, 90.0, 0.0]).double())
        motion[mover.name] = posture + 0.05 * small if mover.motion.startswith("UR") else 0.03 * small
    return Observations.of(torch.rand(4, len(rig.coils), generator=generator, dtype=torch.float64), motion)


@pytest.fixture(params=["end effector", "base", "joints"])
def rig(request: pytest.FixtureRequest, rig_text: str) -> Rig:
    if request.param == "joints":
        return load_rig("configs/two_arms.yaml")
    is_base = request.param == "base"
    return rig_from_text(
        rig_text.replace("  arm1:\n    motion: displacement\n", BASE_FRAME) if is_base else rig_text
    )


def test_it_is_the_models_whatever_the_movers_report(rig):
    readings = some_readings(rig)
    expected_T = perfect_readings(rig, readings)
    field = field_of(rig)
    for row in range(len(readings)):
        assert field(moment_of(rig, readings, row)) == pytest.approx(
            expected_T[row].tolist(), rel=1e-7, abs=1e-12
        )


def test_pose_and_readings_of_a_mover_are_inverse_to_each_other(rig):
    readings = some_readings(rig)
    for mover in rig.movers:
        motion = readings.motion[mover.name]
        there = flange_to_reach(mover, motion, flange(HOME))
        near = motion + 1e-3 if mover.motion.startswith("UR") else torch.zeros_like(motion)
        assert motion_reached(mover, there, flange(HOME), near).flatten().tolist() == pytest.approx(
            motion.flatten().tolist(), abs=1e-9
        )


def test_a_hidden_gain_shows_and_a_drift_grows_with_time(small_rig):
    readings = some_readings(small_rig)
    moment = moment_of(small_rig, readings, 1)
    x_T, y_T, z_T = field_of(small_rig)(moment)
    assert field_of(small_rig, {"axis_gain[hall].y": 0.1})(moment) == pytest.approx((x_T, 1.1 * y_T, z_T))
    drifting = field_of(small_rig, {"offset_drift[hall]": 1e-5})
    assert drifting(moment)[0] == pytest.approx(x_T)
    assert drifting(replace(moment, time_s=7200.0))[0] == pytest.approx(x_T + 2e-5)


def test_a_warm_coil_carries_less_and_a_warm_sensor_reads_otherwise(small_rig):
    readings = some_readings(small_rig)
    moment = moment_of(small_rig, readings, 1)
    warm = replace(moment, coil_temperatures_K=(REFERENCE_K + 10.0,), room_temperature_K=REFERENCE_K + 2.0)
    there_T = field_of(small_rig)(moment)
    assert field_of(small_rig)(warm) == pytest.approx(there_T)
    heating = field_of(small_rig, {"coil_heating.loss_per_K": 4e-3})
    assert heating(moment) == pytest.approx(there_T)
    assert heating(warm) == pytest.approx([0.96 * component_T for component_T in there_T])
    drifting = field_of(small_rig, {"temperature_drift.gain_per_K": 1e-3})
    assert drifting(warm) == pytest.approx([1.002 * component_T for component_T in there_T])


@pytest.mark.parametrize("quantity", ["loss_per_A2", "tau_h"])
def test_coils_of_a_running_rig_warm_up_by_themselves(small_rig, quantity):
    with pytest.raises(InvalidInput, match="coil_heating.* depends on .*loss_per_K"):
        simulated_rig(small_rig, {}, {f"coil_heating[coil1].{quantity}": 1.0})


@pytest.mark.parametrize(
    "cause",
    [
        "current_step",
        "current_remanence",
        "sensor_lag",
        "sensor_exchanged",
        "segment_zero",
        "segment_gain",
        "segment_misplaced",
        "position_lag",
        "backlash",
        "mover_slipped",
        "sensor_bumped",
        "outliers",
        "position_jitter",
    ],
)
def test_a_cause_that_no_moment_shows_is_refused(small_rig, cause):
    with pytest.raises(InvalidInput, match=f"{cause}.* depends on "):
        simulated_rig(small_rig, {}, {cause: 1.0})


def test_a_sensor_inside_the_winding_reads_zero(small_rig):
    readings = some_readings(small_rig)
    readings.motion["arm1"][0] = torch.tensor([0.048, 0.0, 0.045, 0.0, 0.0, 0.0])
    assert field_of(small_rig)(moment_of(small_rig, readings, 0)) == (0.0, 0.0, 0.0)


def test_noise_has_the_width_of_the_truth_and_comes_back_with_its_seed(small_rig):
    real = simulated_rig(small_rig, {"hall.noise_T": 1e-5}, {})
    field = SimulatedField(real, "hall", ("coil1",), {"arm1": HOME}, 7)
    same = pickle.loads(pickle.dumps(field))
    off = Snapshot(0.0, (0.0,), (FlangePose(*HOME),), (REFERENCE_K,), REFERENCE_K)
    samples = torch.tensor([field(off) for _ in range(400)])
    assert samples.std() == pytest.approx(1e-5, rel=0.1)
    assert torch.equal(samples, torch.tensor([same(off) for _ in range(400)]))

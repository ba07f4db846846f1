"""The measurement model: values by hand, frames against each other, and batches against loops."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, radians, sin

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.field.winding import Winding
from estimator.frames import Transform, vector_from_rotation
from estimator.geometry.kinematics import base_from_flange
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates, Values
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from estimator.units import MU0_T_M_PER_A
from tests.by_zones import winding_field
from tests.independent.readings import coil_field_T

LOOP = "radius_mm: 50.5, wire_radius_mm: 0.5, axial_loops: 1, radial_loops: 1"  # of 50 mm, 0.5 mm behind the face
COIL = "radius_mm: 51, wire_radius_mm: 0.49, axial_loops: 12, radial_loops: 8"
COIL_WINDING = Winding(*(torch.tensor(v, dtype=torch.float64) for v in (0.051, 12.0, 8.0, 0.98e-3, 0.98e-3)))


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def rig(coils: str, sensors: str = "hall: {noise_uT: 20}", movers: str = "") -> Rig:
    def block(key: str, text: str) -> str:
        return f"{key}:\n" + "".join(f"  {line}\n" for line in text.strip().splitlines()) if text else ""

    return rig_from_text(
        "schema_version: 1\nname: test\n"
        + block("movers", movers)
        + block("coils", coils)
        + block("sensors", sensors)
    )


def readings(
    current_A: object, motion: Mapping[str, Tensor] | None = None, sensor: list[int] | None = None
) -> Observations:
    current = tensor(current_A)
    return Observations.of(current, motion, sensor=torch.tensor(sensor or [0] * len(current)))


def nominal(of: Rig) -> Values:
    return {name: tensor(value) for name, value in of.nominal_values().items()}


def predict(of: Rig, observations: Observations, tolerance: float = 1e-12) -> Tensor:
    return MeasurementModel.build(of, observations, tolerance).predict(nominal(of))


def random_poses(number: int, seed: int, reach_m: float = 0.03) -> Tensor:
    random = np.random.default_rng(seed)
    return tensor(
        np.concatenate((random.uniform(-1, 1, (number, 3)) * reach_m, random.normal(size=(number, 3))), 1)
    )


def test_fixed_loop_and_sensor_give_the_value_by_hand():
    height_m, a, current_A = 0.0305, 0.05, 2.0
    expected = MU0_T_M_PER_A * current_A * a**2 / (2.0 * (a**2 + height_m**2) ** 1.5)
    field = predict(
        rig(f"coil1: {{{LOOP}}}", "hall: {noise_uT: 20, world_from_sensor: {z_mm: 30}}"), readings([[2.0]])
    )
    torch.testing.assert_close(field, tensor([[0.0, 0.0, expected]]), rtol=1e-14, atol=1e-20)


def test_components_are_those_in_the_sensors_frame():
    """A quarter turn about x puts the sensor's y axis along the coil's axis."""
    straight = predict(
        rig(f"coil1: {{{LOOP}}}", "hall: {noise_uT: 1, world_from_sensor: {x_mm: 9, z_mm: 30}}"),
        readings([[1.0]]),
    )
    turned = predict(
        rig(f"coil1: {{{LOOP}}}", "hall: {noise_uT: 1, world_from_sensor: {x_mm: 9, z_mm: 30, rx_deg: 90}}"),
        readings([[1.0]]),
    )
    bx, _, bz = straight[0].tolist()
    assert bx > 1e-7
    torch.testing.assert_close(turned, tensor([[bx, bz, 0.0]]), rtol=1e-13, atol=1e-20)


def test_sensor_of_a_turned_coil_reads_the_coils_field_turned_into_the_world():
    rotation_vector = np.array([0.7, -0.4, 1.1])
    pose = "{x_mm: 10, y_mm: -20, z_mm: -60, rx_rad: 0.7, ry_rad: -0.4, rz_rad: 1.1}"
    field = predict(rig(f"coil1: {{{COIL}, world_from_coil: {pose}}}"), readings([[3.0]]))
    world_from_coil = Rotation.from_rotvec(rotation_vector)
    point_coil_m = world_from_coil.inv().apply(-np.array([0.01, -0.02, -0.06]))
    field_coil = winding_field(tensor(point_coil_m)[None], COIL_WINDING, 0.0)[0].numpy()
    np.testing.assert_allclose(field[0].numpy(), 3.0 * world_from_coil.apply(field_coil), rtol=1e-11)


TWO_COILS = f"coil1: {{{COIL}, world_from_coil: {{z_mm: -40}}}}\ncoil2: {{{LOOP}, world_from_coil: {{x_mm: 90, ry_deg: -90}}}}"


def test_two_coils_add_up_reading_by_reading():
    both = rig(TWO_COILS)
    field = predict(both, readings([[1.0, 0.0], [0.0, 1.0], [2.0, -3.0], [0.0, 0.0]]))
    torch.testing.assert_close(field[2], 2.0 * field[0] - 3.0 * field[1], rtol=1e-13, atol=1e-20)
    assert (field[3] == 0.0).all()
    assert field[0, 2] > 0.0
    assert field[1, 0] < 0.0


def test_unpowered_coil_costs_nothing_and_may_even_stand_over_the_sensor():
    over_the_sensor = f"\ncoil3: {{{COIL}, world_from_coil: {{x_mm: -47, z_mm: 5}}}}"
    of = rig(TWO_COILS + over_the_sensor)
    model = MeasurementModel.build(of, readings([[1.0, 0.5, 0.0]]), 1e-12)
    assert "coil3" not in model.rules
    expected = predict(rig(TWO_COILS), readings([[1.0, 0.5]]))
    torch.testing.assert_close(model.predict(nominal(of)), expected, rtol=1e-14, atol=0.0)


def test_a_fit_that_puts_a_sensor_into_the_winding_does_not_blame_the_rig_file():
    of = rig(f"coil1: {{{COIL}, world_from_coil: {{z_mm: -40}}}}")
    model = MeasurementModel.build(of, readings([[1.0]]))
    into = {"coil1.world_from_coil.x_m": tensor(-0.047), "coil1.world_from_coil.z_m": tensor(0.005)}
    with pytest.raises(InvalidInput, match=r"at the fitted values 1 of 1 poses .*; run coilcal diagnose"):
        model.choose_rules(nominal(of) | into)
    with pytest.raises(
        InvalidInput, match=r"at the rig's nominal values 1 of 1 poses .*where the rig file puts"
    ):
        MeasurementModel.build(
            rig(f"coil1: {{{COIL}, world_from_coil: {{x_mm: -47, z_mm: 5}}}}"), readings([[1.0]])
        )


def test_where_a_fit_puts_a_sensor_into_the_winding_all_loops_are_added_up():
    """As magpylib adds them up: an error that is told of such a fit is that of the model."""
    of = rig(f"coil1: {{{COIL}}}", "hall: {noise_uT: 20, carried_by: stage}", "stage: {motion: pose}")
    at_m = np.array([[0.0471, 0.0, -0.0053], [0.01, 0.005, 0.03]])
    at_them = readings([[1.0]] * 2, {"stage": torch.from_numpy(np.c_[at_m, np.zeros((2, 3))])})
    told_T = MeasurementModel.for_values(of, at_them, nominal(of)).predict(nominal(of))
    np.testing.assert_allclose(told_T, coil_field_T(at_m, 0.051, 0.00049, 12, 8, 1.0), rtol=1e-9, atol=1e-15)
    by_quadrature_T = (
        MeasurementModel.unruled(of, at_them)
        .choose_rules(nominal(of), is_refusing=False)
        .predict(nominal(of))
    )
    assert (by_quadrature_T - told_T)[0].norm() > 0.02 * told_T[0].norm()


def test_session_without_any_current_predicts_zero():
    of = rig(TWO_COILS)
    assert (
        MeasurementModel.build(of, readings([[0.0, 0.0]] * 2)).predict(nominal(of)).tolist()
        == [[0.0] * 3] * 2
    )


STAGE = "stage: {motion: pose, world_from_base: {x_mm: 5, z_mm: 20, ry_deg: 15}}"
MOVED_SENSOR = "hall: {noise_uT: 20, carried_by: stage, flange_from_sensor: {x_mm: 3, y_mm: -2, rz_deg: 30}}"


def test_repeated_poses_are_evaluated_once_and_give_the_same_as_one_by_one():
    of = rig(TWO_COILS, MOVED_SENSOR, STAGE)
    poses = random_poses(5, seed=1)[[0, 1, 2, 1, 0, 3, 3, 4]]
    current = [
        [1.0, 0.0],
        [0.0, 2.0],
        [1.0, 1.0],
        [-1.0, 0.0],
        [1.0, 0.0],
        [0.5, 0.0],
        [0.0, -1.0],
        [0.0, 1.0],
    ]
    model = MeasurementModel.build(of, readings(current, {"stage": poses}), 1e-12)
    together = model.predict(nominal(of))
    one_by_one = [predict(of, readings([c], {"stage": p[None]})) for c, p in zip(current, poses, strict=True)]
    torch.testing.assert_close(together, torch.cat(one_by_one), rtol=1e-11, atol=1e-18)
    # Of the five poses each coil is on at four.
    assert [len(rows) for rows in model.powered.values()] == [4, 4]


def test_tolerance_of_the_winding_sum_is_met():
    of = rig(TWO_COILS, MOVED_SENSOR, STAGE)
    observations = readings([[1.0, 0.0]] * 30, {"stage": random_poses(30, seed=2)})
    exact = predict(of, observations)
    rough = predict(of, observations, tolerance=1e-4)
    error = ((rough - exact).norm(dim=1) / exact.norm(dim=1)).max().item()
    assert 1e-9 < error < 1e-4


def transform(pose: Tensor) -> Transform:
    return Transform.from_pose(pose[..., :3], pose[..., 3:])


def columns(pose: Transform) -> Tensor:
    return torch.cat((pose.translation_m, vector_from_rotation(pose.rotation)), -1)


def pose_keys(pose: Tensor) -> str:
    names = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
    return (
        "{" + ", ".join(f"{name}: {value!r}" for name, value in zip(names, pose.tolist(), strict=True)) + "}"
    )


COIL_START = tensor([0.01, -0.02, -0.07, 0.3, -0.2, 0.5])  # world_from_coil0
FLANGE_FROM_COIL = tensor([0.004, 0.007, 0.06, -0.6, 0.4, 0.9])


def displaced(frame: str) -> Rig:
    coil = f"coil1: {{{COIL}, carried_by: arm, world_from_coil0: {pose_keys(COIL_START)}, flange_from_coil: {pose_keys(FLANGE_FROM_COIL)}}}"
    return rig(coil, movers=f"arm: {{motion: displacement, {frame}}}")


def test_displaced_coil_sees_the_sensor_where_the_paper_says():
    """Eq 18-22 for pure translations and a sensor at the origin: p = -flange_from_coil.R^T dt - world_from_coil0.R^T t."""
    of = displaced("displacement_frame: end_effector")
    moves_m = random_poses(6, seed=3)
    moves_m[:, 3:] = 0.0
    field = predict(of, readings([[1.5]] * 6, {"arm": moves_m}))
    flange_from_coil = Rotation.from_rotvec(FLANGE_FROM_COIL[3:].numpy())
    world_from_coil = Rotation.from_rotvec(COIL_START[3:].numpy())
    p = -flange_from_coil.inv().apply(moves_m[:, :3].numpy()) - world_from_coil.inv().apply(
        COIL_START[:3].numpy()
    )
    expected = 1.5 * world_from_coil.apply(winding_field(tensor(p), COIL_WINDING, 0.0).numpy())
    np.testing.assert_allclose(field.numpy(), expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("frame", ["end_effector", "base"])
def test_displacements_equal_the_poses_they_come_from(frame):
    """A robot of known base that reports whole poses, rotations included, against displacements from a reference."""
    world_from_base = tensor([0.3, -0.4, 0.1, 0.1, 0.2, -0.3])
    fixed = transform(FLANGE_FROM_COIL)
    flange0 = transform(world_from_base).inverse() @ transform(COIL_START) @ fixed.inverse()
    flange = flange0 @ transform(random_poses(8, seed=4))
    coil = f"coil1: {{{COIL}, carried_by: arm, flange_from_coil: {pose_keys(FLANGE_FROM_COIL)}}}"
    posed = rig(coil, movers=f"arm: {{motion: pose, world_from_base: {pose_keys(world_from_base)}}}")
    expected = predict(posed, readings([[1.0]] * 8, {"arm": columns(flange)}))
    if frame == "end_effector":
        moves, setting = columns(flange0.inverse() @ flange), "displacement_frame: end_effector"
    else:
        shift_m = flange.translation_m - flange0.translation_m
        turn = flange.rotation @ flange0.rotation.mT
        moves = torch.cat((shift_m, vector_from_rotation(turn)), -1)
        keys = zip(
            ("rx_rad", "ry_rad", "rz_rad"), vector_from_rotation(flange0.rotation).tolist(), strict=True
        )
        reference = ", ".join(f"{key}: {value!r}" for key, value in keys)
        setting = f"displacement_frame: base, base_from_flange0: {{{reference}}}"
    field = predict(displaced(setting), readings([[1.0]] * 8, {"arm": moves}))
    torch.testing.assert_close(field, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("robot", ["UR3", "UR3e"])
def test_joint_angles_equal_the_poses_of_the_forward_kinematics(robot):
    joints = tensor(
        np.radians([[0, -90, -90, 0, 90, 0], [3, -88, -93, 4, 92, 40], [-2, -91, -88, -3, 85, -70]])
    )
    base = "world_from_base: {x_mm: -415, y_mm: 131, z_mm: -481, spin_deg: 2}"
    coil = f"coil1: {{{COIL}, carried_by: arm, flange_from_coil: {{z_mm: 70, tilt_x_deg: 3}}}}"
    by_joints = rig(coil, movers=f"arm: {{motion: {robot}, {base}}}")
    by_pose = rig(coil, movers=f"arm: {{motion: pose, {base}}}")
    poses = columns(base_from_flange(robot, joints))
    field = predict(by_joints, readings([[1.0]] * 3, {"arm": joints}))
    torch.testing.assert_close(
        field, predict(by_pose, readings([[1.0]] * 3, {"arm": poses})), rtol=1e-9, atol=1e-15
    )
    assert field.abs().max() > 1e-6


def test_tilts_and_spin_turn_the_sensor_about_its_own_axes_after_its_rotation():
    """In the field of a far loop along world z, so that every component is a cosine by hand."""
    loop = f"coil1: {{{LOOP}, world_from_coil: {{z_mm: -200}}}}"
    (_, _, bz), *_ = predict(rig(loop), readings([[1.0]])).tolist()

    def sees(pose: str) -> list[float]:
        of = rig(loop, f"hall: {{noise_uT: 1, world_from_sensor: {{{pose}}}}}")
        return (predict(of, readings([[1.0]]))[0] / bz).tolist()

    t = radians(20.0)
    assert sees("rx_deg: 90") == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert sees("rx_deg: 90, tilt_x_deg: 20") == pytest.approx([0.0, cos(t), -sin(t)], abs=1e-12)
    assert sees("rx_deg: 90, tilt_y_deg: 20") == pytest.approx(
        [0.0, 1.0, 0.0], abs=1e-12
    )  # own y lies along world z
    assert sees("rx_deg: 90, spin_deg: 20") == pytest.approx([sin(t), cos(t), 0.0], abs=1e-12)
    assert sees("tilt_x_deg: 20") == pytest.approx([0.0, sin(t), cos(t)], abs=1e-12)
    assert sees("tilt_y_deg: 20") == pytest.approx([-sin(t), 0.0, cos(t)], abs=1e-12)


def test_gains_of_current_and_sensor_multiply_the_field():
    sensors = "a: {noise_uT: 1, world_from_sensor: {z_mm: 9}}\nb: {noise_uT: 1, gain: 1.25, world_from_sensor: {z_mm: 9}}"
    of = rig(TWO_COILS.replace(COIL, COIL + ", current_gain: 0.9"), sensors)
    current, sensor = [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]], [0, 0, 1, 1]
    field = predict(of, readings(current, sensor=sensor))
    plain = predict(rig(TWO_COILS, sensors.replace("1.25", "1.0")), readings(current, sensor=sensor))
    factor = tensor([0.9, 1.0, 0.9 * 1.25, 1.25])
    torch.testing.assert_close(field, factor[:, None] * plain, rtol=1e-13, atol=0.0)


def test_every_reading_belongs_to_its_own_sensor():
    sensors = {
        "a": "noise_uT: 1, world_from_sensor: {x_mm: 8}",
        "b": "noise_uT: 1, carried_by: stage, flange_from_sensor: {y_mm: 11, ry_deg: 50}",
        "c": "noise_uT: 1, carried_by: stage, flange_from_sensor: {y_mm: -11, rx_deg: 70}",
    }
    of = rig(TWO_COILS, "\n".join(f"{name}: {{{text}}}" for name, text in sensors.items()), STAGE)
    poses = random_poses(2, seed=5).repeat_interleave(3, 0)
    which = [0, 1, 2, 2, 1, 0]
    field = predict(of, readings([[1.0, 2.0]] * 6, {"stage": poses}, which))
    for i, sensor in enumerate(which):
        name = "abc"[sensor]
        alone = rig(TWO_COILS, f"{name}: {{{sensors[name]}}}", STAGE)
        expected = predict(alone, readings([[1.0, 2.0]], {"stage": poses[i][None]}))
        torch.testing.assert_close(field[i], expected[0], rtol=1e-10, atol=1e-18)


def test_displaced_elements_of_one_sensor_and_a_leaking_supply_concern_theirs_alone():
    sensors = {
        "a": "a: {noise_uT: 1, world_from_sensor: {x_mm: 8}}",
        "b": "b: {noise_uT: 1, carried_by: stage, flange_from_sensor: {y_mm: 11, ry_deg: 50}}",
    }
    room = "background_field[room]: {x_T: 40.0e-6, y_T: 0, z_T: -1.0e-5}\n  current_offset[coil2]: {offset_A: 0.03}"
    positions_m = {
        f"{e}_at_{a}_m": 1e-4 * (3 * i - j) for i, e in enumerate("xyz") for j, a in enumerate("xyz")
    }
    elements = (
        f"element_displacement[b]: {{{', '.join(f'{key}: {at:.4f}' for key, at in positions_m.items())}}}"
    )

    def with_effects(names: str, effects: str) -> Rig:
        plain = rig(TWO_COILS, "\n".join(sensors[name] for name in names), STAGE)
        return rig_from_text(rig_text(plain) + f"effects:\n  {effects}\n")

    poses, which = random_poses(4, seed=8), [1, 0, 1, 0]
    current_A = [[1.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 2.0]]
    both = with_effects("ab", f"{room}\n  {elements}")
    field = predict(both, readings(current_A, {"stage": poses}, which))
    for i, sensor in enumerate(which):
        alone = with_effects("ab"[sensor], room if sensor == 0 else f"{room}\n  {elements}")
        expected = predict(alone, readings([current_A[i]], {"stage": poses[i][None]}))
        torch.testing.assert_close(field[i], expected[0], rtol=1e-10, atol=1e-18)


FREE = f"""
coil1: {{radius_mm: {{prior: {{normal: {{mean: 51, sd: 1}}}}}}, wire_radius_mm: {{prior: {{normal: {{mean: 0.49, sd: 0.01}}}}}},
  axial_loops: {{prior: {{normal: {{mean: 12, sd: 1}}}}}}, radial_loops: {{prior: {{normal: {{mean: 8, sd: 0.5}}}}}},
  world_from_coil: {{z_mm: {{prior: {{normal: {{mean: -40, sd: 2}}}}}}, tilt_x_deg: {{prior: {{normal: {{mean: 0, sd: 2}}}}}}}}}}
coil2: {{{LOOP}, current_gain: {{prior: {{normal: {{mean: 1, sd: 0.1}}}}}}, world_from_coil: {{x_mm: 90, ry_deg: -90}}}}
"""


def test_batch_of_parameter_sets_equals_a_loop_over_them():
    of = rig(FREE, MOVED_SENSOR.replace("20,", "20, gain: {prior: {normal: {mean: 1, sd: 0.1}}},"), STAGE)
    coordinates = Coordinates(of)
    vectors = coordinates.sample_prior(np.random.default_rng(6), 6).reshape(2, 3, -1)
    model = MeasurementModel.build(
        of, readings([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], {"stage": random_poses(3, seed=7)})
    )
    together = model.predict(coordinates.values(vectors))
    assert together.shape == (2, 3, 3, 3)
    for i, j in np.ndindex(2, 3):
        alone = model.predict(coordinates.values(vectors[i, j]))
        torch.testing.assert_close(together[i, j], alone, rtol=1e-12, atol=1e-20)

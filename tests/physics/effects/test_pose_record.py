"""Mistakes in the record of poses, worked out by hand with SciPy's rotations and sums of magpylib's loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.effects.use import as_meant
from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Coordinates
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    DISPLACED,
    POINTS_M,
    RIG,
    assert_same_field,
    effects_text,
    predicted_T,
    readings,
    winding,
)

N = len(POINTS_M)
FIELD_T = 2.0 * winding().field_T(POINTS_M)
ANGLES_RAD = np.random.default_rng(5).uniform(-0.8, 0.8, (N, 3))
FIXED_AXES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def turn_of(angles_rad: np.ndarray, convention: int) -> Rotation:
    """Rotations that three columns mean in a convention."""
    if 1 <= convention <= 6:
        order = FIXED_AXES[convention - 1]
        return Rotation.from_euler(order, angles_rad[:, ["xyz".index(axis) for axis in order]])
    return Rotation.from_rotvec(-angles_rad if convention == 7 else angles_rad)


@pytest.mark.parametrize("per_rad", [1.0, 180.0 / np.pi, 0.5 / np.pi, 1e3, np.pi / 180.0])
@pytest.mark.parametrize("convention", range(8))
def test_rotations_in_each_convention_and_unit_turn_the_sensor_as_scipy_says(convention, per_rad):
    turned = readings(POINTS_M, (2.0, 0.0), turn_rad=per_rad * ANGLES_RAD)
    meant = {"convention": float(convention), "factor": per_rad}
    reading_T = predicted_T(turned, {"rotation_convention[mapper]": meant})
    assert_same_field(reading_T, turn_of(ANGLES_RAD, convention).inv().apply(FIELD_T))


def test_columns_of_yaw_pitch_and_roll_turn_the_sensor_as_scipy_says():
    """Angles about z, y and x of the sensor, one after another, in this order of columns."""
    turned = readings(POINTS_M, (2.0, 0.0), turn_rad=ANGLES_RAD)
    meant = {"convention": 1.0, "x_reads": 3.0, "y_reads": 2.0, "z_reads": 1.0}
    reading_T = predicted_T(turned, {"rotation_convention[mapper]": meant})
    assert_same_field(reading_T, Rotation.from_euler("ZYX", ANGLES_RAD).inv().apply(FIELD_T))


def test_what_the_numbers_of_a_convention_mean_is_told():
    def told(convention: float, factor: float, *reads: float) -> str:
        order = dict(zip(("x_reads", "y_reads", "z_reads"), reads or (1.0, 2.0, 3.0), strict=True))
        given = {"convention": convention, "factor": factor, **order}
        return EFFECTS["rotation_convention"].meaning(given)

    assert told(0.0, 0.159154943) == "turns called radians"
    assert told(7.0, 1.0) == "the inverse rotations"
    yaw_pitch_roll = told(1.0, 57.29577951308232, 3.0, 2.0, 1.0)
    assert yaw_pitch_roll == (
        "angles about fixed axes x, then y, then z; degrees called radians; x, y and z hold z, y and x"
    )


def test_conventions_and_units_in_a_batch_are_those_one_by_one():
    effect = EFFECTS["rotation_convention"]
    here = Transform(torch.eye(3).double().expand(N, 3, 3), torch.from_numpy(POINTS_M))
    columns = torch.from_numpy(ANGLES_RAD)
    each = {"convention": [0.0, 2.0, 7.0], "factor": [1.0, 3.0, 1e3]}
    each |= {"x_reads": [1.0, 3.0, -1.0], "y_reads": [2.0, 1.0, 3.0], "z_reads": [3.0, 2.0, 2.0]}
    both = {key: torch.tensor(values).double() for key, values in each.items()}
    together = effect.apply(here, columns, both).rotation
    for i, alone in enumerate(together):
        theta = {key: value[i] for key, value in both.items()}
        torch.testing.assert_close(effect.apply(here, columns, theta).rotation, alone)


def test_conventions_are_asked_where_the_mover_has_turned():
    effect, rig = EFFECTS["rotation_convention"], rig_from_text(RIG)
    turned = Circumstances(rig, readings(POINTS_M, (2.0, 0.0), turn_rad=ANGLES_RAD))
    assert effect.concerns(turned, "mapper")
    starts = [tuple(start.values()) for start in effect.starts(turned, "mapper")]
    assert len(set(starts)) == len(starts) == (8 * 4 - 1) + 6 * 5 + 46
    in_mrad = Circumstances(rig, readings(POINTS_M, (2.0, 0.0), turn_rad=1e3 * ANGLES_RAD))
    assert len(effect.starts(in_mrad, "mapper")) == len(starts) + 8
    assert not effect.concerns(Circumstances(rig, readings(POINTS_M, (2.0, 0.0))), "mapper")


def test_poses_in_a_frame_that_is_turned_are_turned_back_with_their_rotations():
    turn, real = Rotation.from_euler("zx", [90.0, 45.0], degrees=True), Rotation.from_rotvec(ANGLES_RAD)
    recorded = readings(turn.inv().apply(POINTS_M), (2.0, 0.0), turn_rad=(turn.inv() * real).as_rotvec())
    given = dict(zip(("rx_rad", "ry_rad", "rz_rad"), turn.as_rotvec(), strict=True))
    assert_same_field(predicted_T(recorded, {"pose_frame[mapper]": given}), real.inv().apply(FIELD_T))


def swaps(points_m: np.ndarray, rig_text: str = RIG, mover: str = "mapper") -> list[tuple[float, ...]]:
    """Orders and directions of the columns that a session asks for."""
    recorded = readings(points_m, (2.0, 0.0), mover=mover)
    starts = EFFECTS["positions_swapped"].starts(Circumstances(rig_from_text(rig_text), recorded), mover)
    return [tuple(start.values()) for start in starts]


@pytest.mark.parametrize("reads", [(2.0, 1.0, 3.0), (2.0, 3.0, 1.0), (-3.0, 1.0, -2.0), (-1.0, -2.0, 3.0)])
def test_columns_of_positions_that_are_swapped_hold_each_others_numbers(reads):
    columns_m = np.stack([np.sign(k) * POINTS_M[:, abs(int(k)) - 1] for k in reads], axis=1)
    given = dict(zip(("x_reads", "y_reads", "z_reads"), reads, strict=True))
    assert_same_field(
        predicted_T(readings(columns_m, (2.0, 0.0)), {"positions_swapped[mapper]": given}), FIELD_T
    )
    assert reads in swaps(columns_m)


def test_swapped_columns_are_asked_where_no_other_cause_says_it():
    """Of 48, one is right, and four are those of `left_handed`; displacements in turned axes are a cause of their own, too."""
    assert len(swaps(POINTS_M)) == 48 - 1 - 4
    assert len(swaps(POINTS_M, DISPLACED, "arm")) == 24 - 4
    with pytest.raises(InvalidInput, match="1, 2 and 3 in some order"):
        rig_from_text(RIG + effects_text({"positions_swapped[mapper]": {"x_reads": 2.0}}))


def test_one_axis_in_inches_under_millimetres_is_that_much_longer():
    recorded_m = POINTS_M * np.array([1.0, 1.0 / 25.4, 1.0])
    given = {"x_factor": 1.0, "y_factor": 1.0 / 25.4, "z_factor": 1.0}
    assert_same_field(
        predicted_T(readings(recorded_m, (2.0, 0.0)), {"position_unit[mapper]": given}), FIELD_T
    )


def test_units_are_looked_for_along_axes_that_moved_and_along_all():
    rig = rig_from_text(RIG)
    in_plane_m = POINTS_M * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, 0.03])
    starts = EFFECTS["position_unit"].starts(Circumstances(rig, readings(in_plane_m, (2.0, 0.0))), "mapper")
    changed = {tuple(axis for axis in "xyz" if start[f"{axis}_factor"] != 1.0) for start in starts}
    assert changed == {("x",), ("y",), ("x", "y", "z")}
    assert {1.0 / 25.4, 25.4, 1e3, 1e-3, 10.0, 0.1} == {start["x_factor"] for start in starts} - {1.0}


@pytest.mark.parametrize("late", [1, -1, 2])
def test_field_that_was_written_late_is_that_of_the_poses_and_currents_of_rows_before(late):
    current_A = np.stack((np.linspace(1.0, 3.0, N), np.zeros(N)), axis=1)
    reading_T = predicted_T(readings(POINTS_M, current_A), {"rows_shifted[record]": {"rows": float(late)}})
    true_T = current_A[:, :1] * winding().field_T(POINTS_M)
    inner = slice(late, None) if late > 0 else slice(None, late)
    of_row = slice(None, -late) if late > 0 else slice(-late, None)
    assert_same_field(reading_T[inner], true_T[of_row])


@pytest.mark.parametrize(("late", "of_row"), [(-1, [0, 1, 2, 4, 5, 6]), (1, [0, 1, 2, 2, 3, 4, 5])])
def test_rows_before_a_lost_or_doubled_reading_stay(late, of_row):
    """From the fourth row on, fields are those of the row after (one was lost), or before (one was written twice)."""
    time_s = 600.0 * np.arange(N)
    current_A = np.stack((np.linspace(1.0, 3.0, N), np.zeros(N)), axis=1)
    given = {"rows_shifted_since[record]": {"rows": float(late), "since_h": 1500.0 / 3600.0}}
    reading_T = predicted_T(readings(POINTS_M, current_A, time_s=time_s), given)
    true_T = current_A[:, :1] * winding().field_T(POINTS_M)
    assert_same_field(reading_T[: len(of_row)], true_T[of_row])


def test_readings_of_two_sensors_are_shifted_each_among_its_own():
    time_s = np.arange(N, dtype=float)
    both = readings(POINTS_M, (2.0, 0.0), time_s=time_s)
    both = replace(both, sensor=torch.tensor([0, 1, 1, 0, 0, 1, 0])).with_field(
        torch.from_numpy(FIELD_T.copy())
    )
    moved = both.realigned(1)
    assert moved.motion["mapper"][[3, 4, 6], 0].tolist() == both.motion["mapper"][[0, 3, 4], 0].tolist()
    assert moved.motion["mapper"][[2, 5], 0].tolist() == both.motion["mapper"][[1, 2], 0].tolist()
    assert moved.is_measured.all(-1).tolist() == [False, False, True, True, True, True, True]


def test_realigned_readings_are_put_back_and_not_shifted_twice():
    plain = readings(POINTS_M, (2.0, 0.0)).with_field(torch.from_numpy(FIELD_T.copy()))
    part = plain.rows(torch.tensor([1, 3, 4]))
    moved = part.realigned(1)
    assert moved.realigned(1) is moved
    assert moved.realigned(0) is part
    assert moved.motion["mapper"][:, 0].tolist() == pytest.approx(POINTS_M[[0, 2, 3], 0].tolist())
    assert moved.rows(torch.tensor([2])).realigned(0).motion["mapper"][0, 0] == POINTS_M[4, 0]
    assert torch.equal(moved.realigned(-1).motion["mapper"], part.realigned(-1).motion["mapper"])
    assert torch.equal(moved.history.realigned(0).motion["mapper"], plain.history.motion["mapper"])


def test_density_leaves_out_the_field_that_belongs_to_no_row():
    free = RIG.replace("radius_mm: 40", "radius_mm: {prior: {normal: {mean: 40, sd: 1}}}")
    rig = rig_from_text(free + effects_text({"rows_shifted[record]": {"rows": 1.0}}))
    late_T = np.concatenate((np.full((1, 3), 9.0), FIELD_T[:-1]))
    observations = readings(POINTS_M, (2.0, 0.0)).with_field(torch.from_numpy(late_T))
    density = LogPosterior(Coordinates(rig), MeasurementModel.build(rig, observations, 1e-13), observations)
    assert len(density.measured_T) == 3 * (N - 1)
    assert float(density.whitened(density.coordinates.start()).abs().max()) < 1e-3
    assert as_meant(rig, as_meant(rig, observations)).rows_late == 1


@pytest.mark.parametrize(
    ("given", "rule"),
    [
        ({"rows_shifted[record]": {"rows": 0.5}}, "whole number from -2 to 2"),
        ({"rotation_convention[mapper]": {"convention": 2.5}}, "whole number from 0 to 7"),
        ({"rotation_convention[mapper]": {"factor": 0.0}}, "must be > 0"),
        ({"position_unit[mapper]": {"x_factor": -1.0}}, "must be > 0"),
    ],
)
def test_sizes_that_no_such_mistake_has_are_refused(given, rule):
    with pytest.raises(InvalidInput, match=rule):
        rig_from_text(RIG + effects_text(given))


BASE = "movers: {mapper: {motion: pose, world_from_base: {rx_deg: 40, rz_deg: -25}}}"


@pytest.mark.parametrize("axes", [1, 2])
def test_fields_in_the_axes_of_base_or_room_are_those_that_scipy_turns_back(axes):
    """The sensor's components, turned by its own pose: in the room they are the field itself, in the base what the base sees of it."""
    base = Rotation.from_rotvec(np.deg2rad([40.0, 0.0, -25.0]))
    rig_text = RIG.replace("movers: {mapper: {motion: pose}}", BASE)
    turned = readings(POINTS_M @ base.as_matrix(), (2.0, 0.0), turn_rad=ANGLES_RAD)
    reading_T = predicted_T(turned, {"field_frame[probe]": {"axes": float(axes)}}, rig_text)
    assert_same_field(reading_T, FIELD_T if axes == 2 else base.inv().apply(FIELD_T))


def test_axes_of_the_record_are_asked_where_the_sensor_has_turned_and_a_base_of_its_own_is_there():
    effect = EFFECTS["field_frame"]
    turned = readings(POINTS_M, (2.0, 0.0), turn_rad=ANGLES_RAD)
    rig, with_base = (
        rig_from_text(text) for text in (RIG, RIG.replace("movers: {mapper: {motion: pose}}", BASE))
    )
    assert effect.concerns(Circumstances(rig, turned), "probe")
    assert not effect.concerns(Circumstances(rig, readings(POINTS_M, (2.0, 0.0))), "probe")
    assert effect.starts(Circumstances(rig, turned), "probe") == ({"axes": 2.0},)
    assert effect.starts(Circumstances(with_base, turned), "probe") == ({"axes": 1.0}, {"axes": 2.0})
    still = RIG.replace(
        "probe: {carried_by: mapper, noise_uT: 5}", "probe: {noise_uT: 5, world_from_sensor: {z_mm: 300}}"
    )
    assert effect.places(rig_from_text(still)) == ()
    with pytest.raises(InvalidInput, match="axes must be 0, 1 or 2"):
        rig_from_text(RIG + effects_text({"field_frame[probe]": {"axes": 1.5}}))


def test_axes_of_the_record_in_a_batch_are_those_one_by_one():
    effect, rig = EFFECTS["field_frame"], rig_from_text(RIG.replace("movers: {mapper: {motion: pose}}", BASE))
    circumstances = Circumstances(rig, readings(POINTS_M, (2.0, 0.0), turn_rad=ANGLES_RAD))
    field_T, axes = torch.from_numpy(FIELD_T), torch.arange(3.0, dtype=torch.float64)
    together = effect.apply(field_T, {"axes": axes}, circumstances, "probe")
    for each, recorded_T in zip(axes, together, strict=True):
        torch.testing.assert_close(effect.apply(field_T, {"axes": each}, circumstances, "probe"), recorded_T)
    torch.testing.assert_close(together[0], field_T)

"""Questions answered together are answered as each by itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.predictions import Question, Wanted, answers
from estimator.calibration.result import INTERVAL_DRAWS, Calibration
from estimator.errors import InvalidInput
from estimator.model.room_field import RoomField
from estimator.rig_files.read import rig_from_text
from tests.estimator.calibration.test_result import NO_READINGS

RIG = """
schema_version: 1
name: questions
movers:
  arm: {motion: pose, world_from_base: {z_mm: -80, tilt_y_deg: 5}}
coils:
  coil1: {radius_mm: {prior: {normal: {mean: 51, sd: 1}}}, wire_radius_mm: 0.49, axial_loops: 12, radial_loops: 8,
          carried_by: arm, flange_from_coil: {z_mm: {prior: {normal: {mean: 60, sd: 2}}}}}
  coil2: {radius_mm: 40, axial_pitch_mm: 1.74, radial_pitch_mm: 1.06, axial_loops: 12, radial_loops: 9,
          current_gain: {prior: {normal: {mean: 1.01, sd: 0.01}}}, world_from_coil: {x_mm: 70, y_mm: -30, z_mm: 90, rx_deg: 150}}
sensors: {hall: {noise_uT: 20}}
"""
CAUSES = {
    "none": "",
    "currents": "effects:\n  neighbour_coil[coil1]: {share: 0.02}\n",
    "bodies": "effects:\n  robot_scale[arm]: {x: 0.01, y: 0.0, z: 0.0}\n",
    "room": "effects:\n  background_field[room]: {x_T: 2.0e-5, y_T: 0, z_T: -4.0e-5}\n",
    "iron": "effects:\n  iron_body[room]: {volume_m3: 2.0e-6, x_m: 0.09, y_m: 0.05, z_m: 0.06}\n",
}
ALL = Wanted(has_gradient=True)


def calibration_with(cause: str) -> Calibration:
    """Draws about the nominal values, as a posterior may have them."""
    rig = rig_from_text(RIG + CAUSES[cause])
    best = rig.nominal_values()
    random = np.random.default_rng(0)
    draws = {p.name: best[p.name] * (1.0 + 0.01 * random.normal(size=(8, 60))) for p in rig.free}
    return Calibration(rig, NO_READINGS, best, draws, np.zeros((8, 60)), {})


def question(seed: int, n_points: int, level: float = 0.9, *, is_moved: bool = True) -> Question:
    random = torch.Generator().manual_seed(seed)
    points_m = 0.1 * (torch.rand(n_points, 3, generator=random, dtype=torch.float64) - 0.5)
    motion = 0.02 * torch.randn(6, generator=random, dtype=torch.float64) * is_moved
    return Question(points_m, {"coil1": 1.0 + seed, "coil2": -2.0}, {"arm": motion}, level)


def assert_same(ours: dict[str, Tensor], theirs: dict[str, Tensor], rtol: float) -> None:
    assert ours.keys() == theirs.keys()
    for name, value in ours.items():
        torch.testing.assert_close(value, theirs[name], rtol=rtol, atol=1e-16, equal_nan=True, msg=name)


@pytest.mark.parametrize("cause", CAUSES)
def test_together_is_as_one_by_one(cause):
    calibration = calibration_with(cause)
    questions = [question(0, 3), question(1, 1, 0.5), question(2, 4, 0.68)]
    together = answers(calibration, questions, ALL)
    for asked, answer in zip(questions, together, strict=True):
        call = (asked.points_m, asked.currents_A)
        expected = {
            "field_T": calibration.field(*call, asked.motion),
            "gradient_T_per_m": calibration.gradient(*call, asked.motion),
        }
        ends = calibration.field_interval(*call, asked.level, asked.motion)
        expected["field_lower_T"], expected["field_upper_T"] = ends
        ends = calibration.gradient_interval(*call, asked.level, asked.motion)
        expected["gradient_lower_T_per_m"], expected["gradient_upper_T_per_m"] = ends
        # Iron asks for the coils' field elsewhere than at the points, by the finest rule of them all.
        assert_same(answer, expected, 1e-6 if cause == "iron" else 1e-10)


def test_of_coils_alone_the_answer_has_no_part_of_the_room():
    asked = [question(0, 3), question(1, 2)]
    wanted = Wanted(has_gradient=True, is_of_coils_alone=True)
    expected = answers(calibration_with("none"), asked, Wanted(has_gradient=True))
    for answer, alone in zip(answers(calibration_with("room"), asked, wanted), expected, strict=True):
        assert_same(answer, alone, 1e-10)


def test_questions_in_one_pose_make_one_batch(monkeypatch):
    """Also where effects move bodies; with poses of their own they do without."""
    sizes: list[int] = []
    evaluate = RoomField.field_by_point_T

    def counted(room: RoomField, *arguments: Tensor) -> Tensor:
        sizes.append(len(room.points_m))
        return evaluate(room, *arguments)

    monkeypatch.setattr(RoomField, "field_by_point_T", counted)
    only_best = Wanted(has_intervals=False)
    answers(calibration_with("bodies"), [question(i, 2, is_moved=False) for i in range(3)], only_best)
    answers(calibration_with("none"), [question(i, 2) for i in range(3)], only_best)
    assert sizes == [6, 6]
    answers(calibration_with("bodies"), [question(i, 2) for i in range(3)], only_best)
    assert sizes[2:] == [2, 2, 2]


def test_the_mover_of_a_coil_must_be_named_by_every_question():
    silent = Question(question(0, 1).points_m, {"coil1": 1.0}, {})
    with pytest.raises(InvalidInput, match="motion of arm must be given"):
        answers(calibration_with("none"), [question(1, 1), silent], ALL)


def test_intervals_come_from_400_evenly_spaced_draws():
    calibration = calibration_with("none")
    asked = question(0, 2)
    chosen = np.linspace(0, 8 * 60 - 1, INTERVAL_DRAWS).astype(int)
    radius_m = calibration.draw_values(INTERVAL_DRAWS)["coil1.radius_m"].numpy()
    np.testing.assert_allclose(
        radius_m, calibration.draws["coil1.radius_m"].T.reshape(-1)[chosen], rtol=1e-14
    )
    room = calibration.room(asked.points_m, asked.motion)
    fields_T = room.field_T(calibration.draw_values(INTERVAL_DRAWS), calibration.currents(asked.currents_A))
    expected = torch.quantile(fields_T, torch.tensor([0.05, 0.95], dtype=torch.float64), dim=0)
    answer = answers(calibration, [asked], Wanted())[0]
    torch.testing.assert_close(torch.stack((answer["field_lower_T"], answer["field_upper_T"])), expected)

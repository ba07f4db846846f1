"""Many questions to one calibration in one batch: their points are joined, each with the currents and motions of its question."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.calibration.result import INTERVAL_DRAWS, Calibration
from estimator.effects.stages import MotionEffect
from estimator.effects.use import uses_of
from estimator.model.room_field import some_at_a_time
from estimator.rig.coordinates import Values

FIELD = ("field_T", "field_lower_T", "field_upper_T")
GRADIENT = ("gradient_T_per_m", "gradient_lower_T_per_m", "gradient_upper_T_per_m")


@dataclass(frozen=True)
class Question:
    """Points at which a calibration is asked; arguments as of `Calibration.field_interval`."""

    points_m: Float[Tensor, "point 3"]
    currents_A: Mapping[str, float]
    motion: Mapping[str, Float[Tensor, " 6"]]
    level: float = 0.9


@dataclass(frozen=True)
class Wanted:
    """What all questions of a batch ask for."""

    has_field: bool = True
    has_gradient: bool = False
    has_intervals: bool = True
    is_of_coils_alone: bool = False


def answers(
    calibration: Calibration, questions: Sequence[Question], wanted: Wanted
) -> list[dict[str, Tensor]]:
    """What `field`, `field_interval`, `gradient` and `gradient_interval` of a calibration say to each question, to the sum's tolerance.

    Args:
        calibration: Who is asked.
        questions: At least one.
        wanted: What they ask for.
    Returns: For each question its tensors by the names in `FIELD` and `GRADIENT`, in SI; NaN inside a winding.
    Raises:
        InvalidInput: As by these methods, for any of the questions.
    """
    if wanted.is_of_coils_alone:
        calibration = calibration.coils_alone()
    if not _can_be_joined(calibration, questions):
        return [answers(calibration, [question], wanted)[0] for question in questions]
    room = calibration.room(torch.cat([q.points_m for q in questions]), _motion(questions))
    current_A = _by_point([calibration.currents(q.currents_A) for q in questions], questions)
    answered: list[dict[str, Tensor]] = [{} for _ in questions]

    def add(names: tuple[str, str, str], at: Callable[[Values], Tensor], n_axes: int) -> None:
        """Values of all questions together, told apart by their points, which stand before the axes of a value."""
        sizes = [len(question.points_m) for question in questions]
        best = at(calibration.best_values()).split(sizes, dim=-1 - n_axes)
        for answer, value in zip(answered, best, strict=True):
            answer[names[0]] = value
        if wanted.has_intervals:
            values_of_draws = calibration.draw_values(INTERVAL_DRAWS)
            draws = some_at_a_time(at, values_of_draws, sum(sizes), n_axes + 1).split(sizes, dim=-1 - n_axes)
            for answer, values, question in zip(answered, draws, questions, strict=True):
                shape = answer[names[0]].shape
                answer[names[1]], answer[names[2]] = calibration.ends(values, shape, question.level)

    if wanted.has_field:
        add(FIELD, lambda values: room.field_by_point_T(values, current_A), 1)
    if wanted.has_gradient:
        add(GRADIENT, lambda values: room.gradient_by_point_T_per_m(values, current_A), 2)
    return answered


def _can_be_joined(calibration: Calibration, questions: Sequence[Question]) -> bool:
    """Whether all name the same movers, in one pose where effects move bodies: those are worked out pose by pose anyway."""
    first, *others = (question.motion for question in questions)
    if any(motion.keys() != first.keys() for motion in others):
        return False
    is_one_pose = all(torch.equal(motion[name], first[name]) for motion in others for name in first)
    return is_one_pose or not uses_of(calibration.rig, MotionEffect)


def _motion(questions: Sequence[Question]) -> dict[str, Tensor]:
    return {name: _by_point([q.motion[name] for q in questions], questions) for name in questions[0].motion}


def _by_point(rows: Sequence[Tensor], questions: Sequence[Question]) -> Float[Tensor, "#point number"]:
    """The row of its question for every point, or one row where all questions have the same."""
    if all(torch.equal(row, rows[0]) for row in rows):
        return rows[0][None]
    return torch.cat([row.expand(len(q.points_m), -1) for row, q in zip(rows, questions, strict=True)])

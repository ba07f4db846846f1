"""What a calibration takes for granted, or has fitted beside what its rig file says, in sentences."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.effects.everywhere import WithEverywhere
from estimator.effects.stages import RoomEffect
from estimator.readings.digits import coarse_steps_T
from estimator.readings.observations import Observations
from estimator.reporting.numbers import size_with_unit
from estimator.rig.rig import Cause, Rig

POSE = "_from_"  # part of the names of a pose
ROOM_AND_ZERO = ("background_field[", "sensor_offset[")  # beginnings of their names
MOST_TOLD = 3  # combinations that are not determined, in words; summary.json has all
ONLY_THE_SUM = (
    "No sensor turns, so only the sum of the room's field and of a sensor's zero is known; "
    "fields that currents add are not affected."
)
LEAST_TURN = 0.1  # of an element of a sensor's rotation matrix, from which on readings tell the two apart


def notes(described: WithEverywhere, observations: Observations) -> list[str]:
    """Sentences on what no laboratory is without, on coils that are off, exact gains, iron that is not described, and coarse digits.

    Args:
        described: The rig that was fitted.
        observations: What it was fitted to.
    """
    sentences = []
    if described.added:
        sentences.append(f"Fitted besides, for the rig file does not mention it: {_listed(described.added)}.")
    has_both = all(any(p.name.startswith(name) for p in described.rig.free) for name in ROOM_AND_ZERO)
    if has_both and not _has_turned(described.rig, observations):
        sentences.append(ONLY_THE_SUM)
    if described.missing:
        sentences.append(
            f"The currents changed too little to tell these from the coils by themselves, so they were not fitted: "
            f"{_listed(described.missing)}. Unless they were subtracted from the readings, read places without current too, or name them "
            "under effects in the rig file, so that the pattern of the coils' fields tells them: the Earth's field alone is 25 to 65 µT."
        )
    rig = described.rig
    sentences += [
        f"{coil.name} carries no current in any reading: of its own field all that is known is what the rig file says."
        for coil, current_A in zip(rig.coils, observations.current_A.unbind(dim=1), strict=True)
        if not bool(current_A.any())
    ]
    gains = [f"{coil.name}.current_gain" for coil in rig.wound] + [
        f"{sensor.name}.gain" for sensor in rig.sensors
    ]
    if rig.wound and not any(rig.depends_on_data(name) for name in gains if name in rig.parameters):
        sentences.append(
            "The rig file takes the gains of supply and sensor as exact: if one is 1 % off, so is the number of turns, or sizes and places "
            "are wrong where turns are given. Fields are 1 % off where a sensor's is; where a supply's is, they hold for that supply alone."
        )
    of_coils = [p for coil in rig.wound for p in rig.parameters if p.startswith(f"{coil.name}.")]
    is_fitted = any(rig.depends_on_data(p) for p in of_coils if POSE not in p)
    if is_fitted and not any(map(_answers_coils, rig.effects)):
        sentences.append(
            "The rig file describes no iron: a steel plate or frame near a coil changes its turns and sizes, and may leave no misfit."
        )
    noise_T = [rig.parameters[f"{sensor.name}.noise_T"].value for sensor in rig.sensors]
    sentences += [
        f"{rig.sensors[i].name} reads in steps of {size_with_unit(step_T, 'T', 3)}, coarser than its noise of "
        f"{size_with_unit(noise_T[i], 'T', 3)}: readings are off by up to half a step, and alike where the field hardly changes. "
        "Record more digits."
        for i, step_T in coarse_steps_T(observations, noise_T).items()
    ]
    return sentences


def undetermined_lines(
    undetermined: Sequence[Mapping[str, Any]], fitted_besides: Iterable[str] = ()
) -> list[str]:
    """What the data do not determine, least determined first: the first combinations in words, the others counted."""
    told = told_by_data(undetermined, fitted_besides)
    lines = [f"not determined by the data: {direction['words']}" for direction in told[:MOST_TOLD]]
    if len(told) > MOST_TOLD:
        lines.append(f"not determined by the data: {len(told) - MOST_TOLD} more, which summary.json lists")
    return lines


def told_by_data(
    undetermined: Iterable[Mapping[str, Any]], fitted_besides: Iterable[str]
) -> list[Mapping[str, Any]]:
    """Open directions without those of what was fitted besides, and of room against zero, which notes tell of.

    Args:
        undetermined: Open directions as a summary holds them.
        fitted_besides: Labels of causes, as a summary holds them.
    """
    own = tuple(f"{label}." for label in fitted_besides)

    def is_noted(names: Collection[str]) -> bool:
        is_between_both = all(any(name.startswith(kind) for name in names) for kind in ROOM_AND_ZERO)
        return all(name.startswith(own) for name in names) or (
            is_between_both and all(name.startswith(ROOM_AND_ZERO) for name in names)
        )

    return [direction for direction in undetermined if not is_noted(direction["shares"])]


def _has_turned(rig: Rig, observations: Observations) -> bool:
    """Whether a sensor was turned in the room."""
    carried = [sensor for sensor in rig.sensors if sensor.carried_by is not None]
    if not carried:
        return False
    circumstances = Circumstances(rig, observations)
    turns = (circumstances.world_from(sensor).rotation for sensor in carried)
    return any(float((turn - turn[:1]).abs().max()) > LEAST_TURN for turn in turns)


def _answers_coils(cause: Cause) -> bool:
    """Whether it is something in the room, such as iron, whose field is in proportion to that of the coils."""
    effect = EFFECTS[cause.name]
    return isinstance(effect, RoomEffect) and type(effect).response is not RoomEffect.response


def _listed(causes: Iterable[Cause]) -> str:
    return "; ".join(f"{EFFECTS[cause.name].words} ({cause.label})" for cause in causes)

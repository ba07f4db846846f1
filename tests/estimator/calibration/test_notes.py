"""A calibration says what it takes for granted: exact gains, no iron near its coils, and digits finer than the noise."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.calibration.notes import notes, told_by_data, undetermined_lines
from estimator.effects.everywhere import WithEverywhere, with_everywhere
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.conftest import RIG

PLATE = (
    "effects:\n  iron_plate[room]: {strength: 0.5, axis: 2, tilt_1_rad: 0, tilt_2_rad: 0, distance_m: -0.2}\n"
)
FIELD = "effects:\n  background_field[room]: {x_T: 0, y_T: 0, z_T: -43.0e-6}\n"
KNOWN = RIG.replace("{prior: {normal: {mean: 51, sd: 1}}}", "51").replace(
    "{prior: {normal: {mean: 12, sd: 1, lower: 1}}}", "12"
)


def readings(rig: Rig, step_T: float = 0.0) -> Observations:
    """Thirty readings of each sensor, in steps."""
    field_T = 1e-3 * torch.rand(30, 3, generator=torch.Generator().manual_seed(1)).double()
    field_T = (field_T / step_T).round() * step_T if step_T else field_T
    return Observations.of(torch.zeros(30, len(rig.coils)).double(), {}, field_T)


def told_of(text: str, step_T: float = 0.0) -> list[str]:
    rig = rig_from_text(text)
    return notes(WithEverywhere(rig), readings(rig, step_T))


@pytest.mark.parametrize(("step_uT", "is_told"), [(0.0, False), (10.0, False), (20.0, True)])
def test_steps_of_the_last_digit_that_exceed_the_noise_are_told(step_uT, is_told):
    """Of a sensor with 5 uT."""
    told = [note for note in told_of(RIG, 1e-6 * step_uT) if "reads in steps of" in note]
    assert bool(told) is is_told


def test_a_coil_that_is_never_on_is_told():
    rig = rig_from_text(RIG)
    for current_A, n_told in ((0.0, 1), (3.0, 0)):
        observations = replace(readings(rig), current_A=torch.full((30, 1), current_A).double())
        told = notes(WithEverywhere(rig), observations)
        assert sum("coil1 carries no current in any reading" in note for note in told) == n_told


@pytest.mark.parametrize(
    ("text", "is_told"),
    [(RIG, True), (RIG + FIELD, True), (RIG + PLATE, False), (KNOWN, False)],
    ids=["nothing described", "a field of the room", "a plate", "a winding that is known"],
)
def test_iron_that_turns_and_sizes_would_absorb_is_told_where_none_is_described(text, is_told):
    told = [note for note in told_of(text) if "describes no iron" in note]
    assert bool(told) is is_told


def test_room_against_zero_is_one_note_and_no_warning_for_each_axis():
    """Rigs of `coilcal init` have both; six warnings beside `good` would frighten."""
    free = "{x_T: {prior: {normal: {mean: 0, sd: 5.0e-5}}}, y_T: 0, z_T: 0}"
    room, zero = f"  background_field[room]: {free}\n", f"  sensor_offset[hall]: {free}\n"

    def told(*effects: str) -> bool:
        return any("only the sum" in note for note in told_of("".join(effects)))

    assert told(RIG, "effects:\n", room, zero)
    assert not told(RIG, "effects:\n", room)
    assert not told(RIG, FIELD, zero)  # one of them is known

    def direction(*names: str) -> dict:
        return {"words": "", "data_over_prior_sd": 2.0, "shares": dict.fromkeys(names, 1.0)}

    together = direction("sensor_offset[hall].x_T", "background_field[room].x_T")
    alone = direction("sensor_offset[hall].x_T")
    beside = direction("sensor_offset[hall].x_T", "background_field[room].x_T", "coil1.radius_m")
    assert told_by_data([together, alone, beside], ()) == [alone, beside]
    assert told_by_data([alone, beside], ("sensor_offset[hall]",)) == [beside]


CARRIED = RIG.replace("motion: displacement", "motion: pose").replace("    carried_by: arm1\n", "", 1)
CARRIED = CARRIED.replace("world_from_coil0", "world_from_coil").replace(
    "hall:", "hall:\n    carried_by: arm1"
)


@pytest.mark.parametrize("turn_rad", [0.0, 0.3])
def test_room_and_zero_are_one_number_only_where_no_sensor_turns(turn_rad):
    rig = rig_from_text(CARRIED)
    motion = torch.zeros(30, 6).double()
    motion[10:, 4] = turn_rad
    turned = replace(readings(rig), motion={"arm1": motion}, current_A=torch.arange(30.0)[:, None].double())
    told = notes(with_everywhere(rig, turned), turned)
    assert any(note.startswith("Fitted besides") for note in told)
    assert any("only the sum" in note for note in told) is (turn_rad == 0.0)


def test_three_open_combinations_are_told_and_the_others_counted():
    told = [{"words": f"coil{i} turns", "shares": {f"coil{i}.turns": 1.0}} for i in range(5)]
    first = [f"not determined by the data: coil{i} turns" for i in range(3)]
    assert undetermined_lines(told[:3]) == first
    assert undetermined_lines(told) == [
        *first,
        "not determined by the data: 2 more, which summary.json lists",
    ]


def test_a_supply_that_is_off_is_not_said_to_make_its_own_fields_wrong():
    """They are of the current that it was asked for, as the readings were."""
    (told,) = (note for note in told_of(KNOWN) if "gains of supply and sensor" in note)
    assert "so is the number of turns, or sizes and places are wrong where turns are given." in told
    assert "where a supply's is, they hold for that supply alone." in told

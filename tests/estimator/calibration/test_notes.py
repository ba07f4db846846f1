"""A calibration says what it takes for granted: exact gains, and no iron near its coils."""

from __future__ import annotations

import pytest

from estimator.calibration.notes import notes, told_by_data
from estimator.effects.everywhere import WithEverywhere
from estimator.rig_files.read import rig_from_text
from tests.estimator.conftest import RIG

PLATE = (
    "effects:\n  iron_plate[room]: {strength: 0.5, axis: 2, tilt_1_rad: 0, tilt_2_rad: 0, distance_m: -0.2}\n"
)
FIELD = "effects:\n  background_field[room]: {x_T: 0, y_T: 0, z_T: -43.0e-6}\n"
KNOWN = RIG.replace("{prior: {normal: {mean: 51, sd: 1}}}", "51").replace(
    "{prior: {normal: {mean: 12, sd: 1, lower: 1}}}", "12"
)


@pytest.mark.parametrize(
    ("text", "is_told"),
    [(RIG, True), (RIG + FIELD, True), (RIG + PLATE, False), (KNOWN, False)],
    ids=["nothing described", "a field of the room", "a plate", "a winding that is known"],
)
def test_iron_that_turns_and_sizes_would_absorb_is_told_where_none_is_described(text, is_told) -> None:
    told = [note for note in notes(WithEverywhere(rig_from_text(text))) if "describes no iron" in note]
    assert bool(told) is is_told


def test_room_against_zero_is_one_note_and_no_warning_for_each_axis() -> None:
    """Rigs of `coilcal init` have both; six warnings beside `good` would frighten."""
    free = "{x_T: {prior: {normal: {mean: 0, sd: 5.0e-5}}}, y_T: 0, z_T: 0}"
    room, zero = f"  background_field[room]: {free}\n", f"  sensor_offset[hall]: {free}\n"

    def told(*effects: str) -> bool:
        return any("only the sum" in note for note in notes(WithEverywhere(rig_from_text("".join(effects)))))

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

"""No mistake of the record is found where something else is wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.hypotheses import record_mistakes
from estimator.diagnosis.hypotheses.instants import changes_at_its_instant
from estimator.diagnosis.hypotheses.record_mistakes import without_record_mistakes
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.use import shifts_rows
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from tests.estimator.conftest import RIG
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole


def test_right_record_is_left_alone(small_rig, small_session):
    fit = fit_of(small_rig, small_session.observations.calibration)
    assert without_record_mistakes(fit) == (fit, [])


def test_zero_of_the_sensor_that_is_off_is_no_mistake_of_the_record(
    small_rig, small_truth, small_session, monkeypatch
):
    """With one rotation only, for the whole search takes half a minute."""
    monkeypatch.setattr(record_mistakes, "EFFECTS", {"displacement_frame": EFFECTS["displacement_frame"]})
    monkeypatch.setattr(record_mistakes, "MOST_MISTAKES", 1)
    turned = {"rx_rad": 0.0, "ry_rad": 0.0, "rz_rad": 0.25 * math.pi}
    monkeypatch.setattr(type(EFFECTS["displacement_frame"]), "starts", lambda *_: (turned,))
    truth_rig = small_rig.with_values(small_truth)
    cause = Cause("sensor_offset", "hall")
    readings = with_wrong(truth_rig, small_session.observations, cause, {"y_T": 40e-6}).calibration
    _, mistakes = without_record_mistakes(fit_of(small_rig, readings))
    assert [mistake.cause.name for mistake in mistakes] == []


def test_fields_that_were_written_beside_their_rows_are_put_back(small_rig, small_session, monkeypatch):
    """The field that the first row was left with belongs to none, and may be anything. Beside one other mistake, for each takes seconds."""
    known = {name: EFFECTS[name] for name in ("rows_shifted", "left_handed")}
    monkeypatch.setattr(record_mistakes, "EFFECTS", known)
    monkeypatch.setattr(record_mistakes, "MOST_MISTAKES", 1)
    some = small_session.observations.rows(torch.arange(0, len(small_session.observations), 2)).alone
    field_T = some.field_sensor_T.roll(1, 0)
    field_T[0] = 1e-2
    readings = some.with_field(field_T)
    fit, mistakes = without_record_mistakes(fit_of(small_rig, readings))
    (mistake,) = mistakes
    assert mistake.cause == Cause("rows_shifted", "record")
    assert float(fit.values[f"{mistake.cause.label}.rows"]) == 1.0
    assert float(fit.residual.square().mean()) == pytest.approx(1.0, abs=0.3)


def test_columns_of_a_mover_that_are_exchanged_are_put_back(small_rig, small_session, monkeypatch):
    """Beside reversed axes, which explain a part of it."""
    known = {name: EFFECTS[name] for name in ("left_handed", "positions_swapped")}
    monkeypatch.setattr(record_mistakes, "EFFECTS", known)
    readings = small_session.observations.alone
    (mover,) = small_rig.movers
    exchanged = readings.motion[mover.name][:, [0, 2, 1, 3, 4, 5]]
    fit, mistakes = without_record_mistakes(
        fit_of(small_rig, replace(readings, motion={mover.name: exchanged}))
    )
    (mistake,) = mistakes
    assert mistake.cause == Cause("positions_swapped", mover.name)
    reads = [float(fit.values[f"{mistake.cause.label}.{axis}_reads"]) for axis in "xyz"]
    assert reads == [1.0, 3.0, 2.0]
    assert float(fit.residual.square().mean()) == pytest.approx(1.0, abs=0.3)


def test_a_reversed_coil_that_was_first_read_without_current_is_reversed_from_the_beginning(
    small_rig, small_session, monkeypatch
):
    """From an instant before the first current on, or always: the readings are the same."""
    known = {name: EFFECTS[name] for name in ("current_sign", "current_sign_since")}
    monkeypatch.setattr(record_mistakes, "EFFECTS", known)
    readings = small_session.observations.alone
    order = readings.time_s.argsort()
    current_A, field_T = -readings.current_A, readings.field_sensor_T.clone()
    idle = order[: len(order) // 3]
    current_A[idle], field_T[idle] = 0.0, 1e-6
    first_without = replace(readings, current_A=current_A).with_field(field_T)
    _, mistakes = without_record_mistakes(fit_of(small_rig, first_without))
    (mistake,) = mistakes
    assert mistake.cause == Cause("current_sign", "coil1")
    assert mistake.alternatives == ()


@pytest.mark.parametrize("taken", ["rows_shifted", "rows_shifted_since"])
def test_rows_that_are_shifted_already_are_not_shifted_again(small_rig, small_session, monkeypatch, taken):
    """Readings that make no sense ask for a second shift, whichever of the two was taken first."""
    shifts = {name: effect for name, effect in EFFECTS.items() if shifts_rows(effect)}
    assert set(shifts) == {"rows_shifted", "rows_shifted_since"}
    monkeypatch.setattr(record_mistakes, "EFFECTS", shifts)
    readings = small_session.observations.alone
    plain = fit_of(small_rig, readings.with_field(readings.field_sensor_T.flip(0)))
    cause = Cause(taken, "record")
    (start, *_) = EFFECTS[taken].starts(plain.posterior.model.circumstances, "record")
    rig = with_effect(plain.rig, cause, plain.observations, start)
    shifted = fit_rig(rig, plain.observations, plain.start_with(rig), plain.posterior.model.rules)
    assert not record_mistakes._is_as_expected(shifted)
    fit, mistakes = without_record_mistakes(shifted)
    assert (fit, mistakes) == (shifted, [])


@pytest.mark.parametrize("begins_at", [8, 17])
def test_an_axis_that_is_reversed_in_mid_session_is_found_to_the_reading(
    small_rig, small_session, monkeypatch, begins_at
):
    """Not at one of the instants that fits start from."""
    known = {name: EFFECTS[name] for name in ("axes_swapped_since", "current_sign_since", "axes_swapped")}
    monkeypatch.setattr(record_mistakes, "EFFECTS", known)
    readings = small_session.observations.alone
    field_T = readings.field_sensor_T.clone()
    field_T[begins_at:, 1] *= -1.0
    fit, mistakes = without_record_mistakes(fit_of(small_rig, readings.with_field(field_T)))
    (mistake,) = mistakes
    assert mistake.cause == Cause("axes_swapped_since", "hall")
    since_h = float(fit.values[f"{mistake.cause.label}.since_h"])
    noise_T = float(fit.values["hall.noise_T"])
    is_late = torch.arange(len(readings)) >= begins_at
    is_taken_wrongly = ((readings.time_s - readings.time_s[0]) / 3600.0 > since_h) != is_late
    assert not (field_T[is_taken_wrongly, 1].abs() > 4.0 * noise_T).any()  # others have no sign to be seen
    assert float(fit.residual.square().mean()) == pytest.approx(1.0, abs=0.3)


def test_a_free_noise_does_not_hide_columns_of_a_mover_that_are_exchanged(small_session, monkeypatch):
    """A wide prior lets the noise follow what the record got wrong; readings at the same places scatter much less."""
    monkeypatch.setattr(record_mistakes, "EFFECTS", {"positions_swapped": EFFECTS["positions_swapped"]})
    rig = rig_from_text(
        RIG.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 100, relative_sd: 2}}}")
    )
    readings = small_session.observations.alone
    (mover,) = rig.movers
    exchanged = readings.motion[mover.name][:, [0, 2, 1, 3, 4, 5]]
    fit = fit_of(rig, replace(readings, motion={mover.name: exchanged}))
    monkeypatch.setattr(record_mistakes, "_is_as_expected", lambda _: True)
    monkeypatch.setattr(record_mistakes, "scatter_T", lambda *_: [5e-6])
    (mistake,) = without_record_mistakes(fit)[1]
    assert mistake.cause == Cause("positions_swapped", mover.name)
    monkeypatch.setattr(record_mistakes, "scatter_T", lambda *_: [float(fit.values["hall.noise_T"])])
    assert without_record_mistakes(fit)[1] == []


def test_a_single_row_is_no_spell_of_a_mistake(small_rig, small_session):
    """One wild reading between two instants asks for a coil that was connected the other way round for a second."""
    readings = small_session.observations.alone
    order = readings.time_s.argsort()
    hours = (readings.time_s[order] - readings.time_s.min()) / 3600.0
    for n, is_one in ((1, False), (8, True)):
        since_h, until_h = (float(0.5 * (hours[row - 1] + hours[row])) for row in (10, 10 + n))
        spell = {"sign": -1.0, "since_h": since_h, "until_h": until_h}
        rig = with_effect(small_rig, Cause("current_sign_spell", "coil1"), readings, spell)
        assert changes_at_its_instant(fit_of(rig, readings)) is is_one


def test_rows_that_are_shifted_from_an_instant_on_are_found(small_rig, small_session, monkeypatch):
    """Which fields stand beside which rows is no number of the model: no other instant is predicted by it."""
    monkeypatch.setattr(record_mistakes, "EFFECTS", {"rows_shifted_since": EFFECTS["rows_shifted_since"]})
    readings = small_session.observations.alone
    half = len(readings) // 2
    field_T = readings.field_sensor_T.clone()
    field_T[half:] = readings.field_sensor_T[half - 1 : -1]
    _, mistakes = without_record_mistakes(fit_of(small_rig, readings.with_field(field_T)))
    assert [mistake.cause.name for mistake in mistakes] == ["rows_shifted_since"]

from __future__ import annotations

import json

import pytest
import torch

from estimator import InvalidInput, design, load_plan
from tests.estimator.diagnosis.sessions import RIG, session_with, together

OFFSET = (("sensor_offset.z_T", 60e-6), ("sensor_offset.x_T", 50e-6))
TWINS = ("background_field", "sensor_offset")


def test_a_turned_sensor_tells_a_field_of_the_room_from_an_offset_and_nothing_else_does():
    proposed = design(session_with(OFFSET, (3.0,), 1), split=TWINS, n_readings=5)
    assert proposed.so_far == pytest.approx(0.0, abs=0.1)
    told = json.loads(json.dumps(proposed.to_json(), allow_nan=False))
    assert [p["expected_log_evidence"] for p in told["programmes"]] == [
        p.expected_log_evidence for p in proposed.actions
    ]
    assert (told["reached"], told["plan"]) == (list(proposed.reached), proposed.plan)
    for proposal in proposed.actions:
        brings = proposal.expected_log_evidence
        assert (brings > 5.0) if "turned" in proposal.action.words else (brings < 0.1)
    assert max(proposed.reached) < 0.1


def test_every_stop_adds_evidence_and_the_first_choices_add_most():
    proposed = design(session_with((), (3.0,), 1), split=("axis_gain", "cross_axis"), n_readings=8)
    reached = torch.tensor([proposed.so_far, *proposed.reached])
    gains = torch.diff(reached)
    assert bool((gains > -1e-6).all())
    assert float(gains[:4].mean()) > float(gains[4:].mean())
    # No field, nothing of either: that the readings so far tell them apart already is no merit of what comes next.
    dark = next(proposal for proposal in proposed.actions if "without current" in proposal.action.words)
    assert proposed.so_far > 3.0
    assert dark.expected_log_evidence == pytest.approx(0.0, abs=0.1)


def test_a_second_current_is_asked_for_to_see_whether_iron_saturates():
    hidden = (("core_saturation.share", 0.1), ("core_saturation.loss_per_A2", 5e-3))
    proposed = design(session_with(hidden, (3.0,), 1), split=("iron_core", "core_saturation"), n_readings=6)
    strengths = proposed.readings.current_A.abs().squeeze(1)
    assert bool((strengths < 2.0).any())


def test_the_standard_deviation_foretold_is_that_of_a_fit_to_the_stops(tmp_path):
    from estimator import Session, simulate
    from estimator.diagnosis.fitting import fit_rig
    from estimator.model.measurement_model import MeasurementModel
    from tests.estimator.diagnosis.sessions import TRUTH

    session = session_with((), (3.0,), 1)
    proposed = design(session, shrink="coil1.radius_m", n_readings=20)
    path = tmp_path / "plan.yaml"
    path.write_text(proposed.plan)
    more = simulate(RIG, load_plan(path, RIG), TRUTH, 5)
    assert len(more) == 20

    both = together(session.observations, more)
    fit = fit_rig(RIG, both, TRUTH, MeasurementModel.build(RIG, both).rules)
    assert proposed.reached[-1] < 0.97 * proposed.so_far
    assert fit.value_sd("coil1.radius_m") == pytest.approx(proposed.reached[-1], rel=0.15)
    assert Session(RIG, both, "both").observations.time_s.max() > 1e4


def test_a_field_of_the_room_that_a_calibration_fits_is_not_taken_for_noise():
    earth = (("background_field.x_T", 60e-6), ("background_field.z_T", 60e-6))
    without, beside = (
        design(session_with(hidden, (3.0, 1.5), 1), shrink="coil1.radius_m", n_readings=3)
        for hidden in ((), earth)
    )
    assert [beside.so_far, *beside.reached] == pytest.approx([without.so_far, *without.reached], rel=0.1)


def test_a_field_of_the_room_is_no_noise_for_causes_that_are_to_be_told_apart():
    gain, earth = ("axis_gain.x", 0.01), (("background_field.x_T", 60e-6), ("background_field.z_T", 60e-6))
    without, beside = (
        design(session_with(hidden, (3.0, 1.5), 1), split=("axis_gain", "element_displacement"), n_readings=3)
        for hidden in ((gain,), (gain, *earth))
    )
    assert [beside.so_far, *beside.reached] == pytest.approx([without.so_far, *without.reached], rel=0.1)


def test_a_size_that_the_readings_do_not_show_is_told_as_supposed():
    shown = design(
        session_with((("axis_gain.x", 0.03),), (3.0,), 1), split=("axis_gain", "cross_axis"), n_readings=1
    )
    supposed = "supposing cross_axis[hall] "
    assert supposed in shown.goal
    assert supposed in shown.plan
    assert "supposing axis_gain" not in shown.goal
    clean = design(session_with((), (3.0,), 1), split=("axis_gain", "cross_axis"), n_readings=1)
    assert "supposing axis_gain[hall] " in clean.goal


@pytest.mark.parametrize(
    ("goals", "words"),
    [
        ({}, "must split two or more causes, or shrink one parameter"),
        ({"split": ("axis_gain",)}, "must split two or more causes"),
        ({"split": TWINS, "shrink": "coil1.radius_m"}, "must split two or more causes"),
        ({"split": ("axis_gain", "axis_gian")}, "the closest is axis_gain"),
        ({"split": ("axis_gain[probe]", "cross_axis")}, "must say where, one of hall"),
        ({"split": ("current_gain", "cross_axis")}, "the fit follows it wholly"),
        ({"shrink": "coil1.raduis_m"}, "received 'coil1.raduis_m'; the closest is coil1.radius_m"),
        ({"shrink": "hall.world_from_sensor.x_m"}, "must name a parameter that the fit may change"),
    ],
)
def test_goals_that_make_no_sense_are_refused(goals, words):
    with pytest.raises(InvalidInput, match=words.replace("[", r"\[")):
        design(session_with((), (3.0,), 1), **goals)  # type: ignore[arg-type]

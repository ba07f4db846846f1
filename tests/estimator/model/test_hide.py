from __future__ import annotations

import math

import pytest
import torch

from estimator import InvalidInput, simulate
from estimator.effects import EFFECTS
from estimator.model.hide import cause_of, full_names, hidden_shapes
from estimator.model.simulate import idle_causes
from tests.estimator.diagnosis.sessions import RIG, TRUTH, session_with

SILENT = {**TRUTH, "hall.noise_T": 0.0}


def readings(
    hidden: dict[str, float], truth: dict[str, float] | None = None, n_segments: int = 1
) -> torch.Tensor:
    from tests.estimator.diagnosis.sessions import PLAN, Path, _folder, load_plan

    path = Path(_folder()) / "hide.yaml"
    path.write_text(PLAN.replace("CURRENTS", "[{coil1: 3}, {coil1: -3}]"))
    return simulate(RIG, load_plan(path, RIG), truth or SILENT, 3, hidden, n_segments).field_sensor_T


def test_a_hidden_gain_multiplies_the_component_it_names():
    ratio = readings({"axis_gain[hall].y": 0.02}) / readings({})
    assert ratio.mean(0).tolist() == pytest.approx([1.0, 1.02, 1.0])


def test_without_quantity_the_first_is_meant_and_without_place_the_only_one():
    assert full_names(RIG, {"axis_gain": 0.01}) == {"axis_gain[hall].x": 0.01}
    assert torch.equal(readings({"axis_gain": 0.01}), readings({"axis_gain[hall].x": 0.01}))
    assert cause_of("iron_plate", RIG).label == "iron_plate[room]"


def test_a_cause_at_its_null_hides_nothing():
    assert torch.equal(readings({"axis_gain": 0.0, "current_offset": 0.0}), readings({}))


def test_a_cause_that_makes_no_number_of_a_field_is_refused(monkeypatch):
    """A reading that is no number would be written as one that is missing."""
    broken = staticmethod(lambda field_sensor_T, *_: field_sensor_T / torch.zeros_like(field_sensor_T))
    monkeypatch.setattr(type(EFFECTS["axis_gain"]), "apply", broken)
    with pytest.raises(
        InvalidInput, match=r"with axis_gain\.y must be finite, .* for reading 1, at \[3.0\] A"
    ):
        readings({"axis_gain.y": 0.02})


def test_causes_that_change_no_reading_of_a_session_are_told():
    session = session_with((), (3.0, -3.0), 3)
    hidden = {"axis_gain": 0.01, "temperature_drift": 0.001, "sensor_offset.x_T": 0.0, "outliers.share": 0.1}
    assert idle_causes(RIG, session.observations, hidden) == ["temperature_drift[hall].gain_per_K"]


def test_the_noise_is_the_same_whatever_is_hidden():
    noise = readings({}, TRUTH) - readings({})
    with_offset = readings({"sensor_offset.z_T": 1e-4}, TRUTH) - readings({"sensor_offset.z_T": 1e-4})
    assert with_offset.flatten().tolist() == pytest.approx(noise.flatten().tolist(), abs=1e-12)


def test_the_place_and_instant_that_were_chosen_are_told_and_make_the_same_readings():
    hidden = {"iron_body[room].volume_m3": 1e-4, "iron_body[room].x_m": 0.2, "offset_step[hall].x_T": 1e-4}
    session = session_with((), (3.0, -3.0), 3)
    chosen = hidden_shapes(RIG, session.observations, hidden)
    keys = ("iron_body[room].x_m", "iron_body[room].y_m", "iron_body[room].z_m", "offset_step[hall].since_h")
    assert tuple(chosen) == keys
    assert chosen["iron_body[room].x_m"] == 0.2
    assert torch.equal(readings(hidden | chosen), readings(hidden))


def test_a_segment_of_the_session_has_its_own_zero():
    added_T = readings({"segment_zero.segment2_y_T": 1e-4}, n_segments=3) - readings({})
    expected_T = torch.zeros_like(added_T)
    expected_T[64:, 1] = 1e-4  # of 96 readings
    torch.testing.assert_close(added_T, expected_T, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(("key", "n_segments"), [("segment3_x_T", 3), ("segment0_x_T", 1)])
def test_a_segment_that_the_session_has_not_is_refused(key, n_segments):
    with pytest.raises(InvalidInput, match=f"segment that the session has; received {key}"):
        readings({f"segment_zero[hall].{key}": 1e-4}, n_segments=n_segments)


def test_outliers_scatter_as_often_and_as_far_as_they_are_said_to():
    plain = (readings({}, TRUTH) - readings({})) / 20e-6
    wild = (readings({"outliers.share": 0.2, "outliers.ratio": 100.0}, TRUTH) - readings({})) / 20e-6
    share = float((wild.abs() > 8.0).double().mean())
    n = wild.numel()
    # A component of 100 sigma is beyond 8 with probability 0.936.
    assert share == pytest.approx(0.2 * 0.936, abs=4.0 * math.sqrt(0.2 * 0.8 / n))
    assert float(plain.abs().max()) < 5.0


def test_a_mover_that_scatters_disturbs_the_readings_by_its_distance_times_the_gradient():
    from estimator.model.measurement_model import MeasurementModel
    from estimator.model.nominal import NominalPrediction

    observations = session_with((), (3.0, -3.0), 1).observations
    gradient = NominalPrediction(
        MeasurementModel.build(RIG.with_values(TRUTH), observations)
    ).gradient_T_per_m("arm1")
    expected_T = 1e-4 * float(gradient.square().sum(-1).mean().sqrt())
    off_T = readings({"position_jitter": 1e-4}) - readings({})
    assert float(off_T.square().mean().sqrt()) == pytest.approx(expected_T, rel=0.15)


def test_fields_in_another_unit_take_their_noise_along():
    wrong_unit_T = readings({"unit_error.field_factor": 1e3}, TRUTH)
    assert wrong_unit_T.flatten().tolist() == pytest.approx((1e3 * readings({}, TRUTH)).flatten().tolist())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("axis gain", "must look like cause"),
        ("axis_gian", "the closest is axis_gain"),
        ("axis_gain[probe]", "must say where, one of hall"),
        ("axis_gain[hal]", r"must say where, one of hall; received 'axis_gain\[hal\]'; the closest is hall"),
        ("axis_gain.q", "must be given by one of x, y, z"),
        ("current_gain.exces", "received 'current_gain.exces'; the closest is excess"),
        ("segment_gain.gain", "must be given by one of segment0_gain, segment1_gain"),
    ],
)
def test_causes_that_do_not_exist_are_refused(text: str, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        readings({text: 1.0})

"""The extended rig predicts what the fit predicts, keeps its description word by word, and survives its file."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.extension import extended_rig
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.readings.observations import Observations
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.write import rig_text
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T

pytestmark = pytest.mark.whole

CAUSES = (
    Cause("axis_gain", "hall"),
    Cause("background_field", "room"),
    Cause("position_lag", "arm1"),
    Cause("iron_core", "coil1"),
)


@pytest.fixture(scope="module")
def readings(small_session: Session) -> Observations:
    return small_session.observations.calibration


@pytest.fixture(scope="module")
def extended(small_rig: Rig, readings: Observations) -> Fit:
    return fit_of(small_rig, readings, *CAUSES)


@pytest.fixture(scope="module")
def rig(small_rig: Rig, extended: Fit) -> Rig:
    return extended_rig(small_rig, extended)


def untied(fit: Fit) -> dict[str, float]:
    return {name: float(v) for name, v in fit.values.items() if fit.rig.parameters[name].tie is None}


def test_extended_file_loads_and_predicts_what_the_fit_predicts(rig, extended, readings, tmp_path):
    """The file keeps the rig's nominal values; with the fit's values in their place the predictions agree."""
    path = tmp_path / "rig_extended.yaml"
    path.write_text(rig_text(rig, "by coilcal diagnose"), encoding="utf-8")
    loaded = load_rig(path)
    assert loaded == rig
    assert loaded.hash == rig.hash
    assert loaded.effects == CAUSES
    extended_values = {name: value for name, value in untied(extended).items() if "[" not in name}
    assert torch.equal(
        predicted_T(loaded.with_values(extended_values), readings),
        predicted_T(extended.rig.with_values(untied(extended)), readings),
    )


def test_extended_rig_is_free_where_the_fit_was_with_the_same_priors(rig, extended):
    assert [p.name for p in rig.free] == [p.name for p in extended.rig.free]
    assert {p.name: p.prior for p in rig.free} == {p.name: p.prior for p in extended.rig.free}


def test_fitting_the_extended_rig_again_finds_the_same(rig, extended, readings):
    again = fit_rig(rig, readings, {}, extended.posterior.model.rules)
    for name, value in extended.values.items():
        assert float(again.values[name] - value) == pytest.approx(
            0.0, abs=0.02 * extended.value_sd(name) + 1e-15
        )


def test_rest_of_the_rig_is_kept(rig, small_rig):
    bare = rig
    for cause in CAUSES:
        bare = bare.without_cause(cause)
    assert bare == small_rig


def test_rig_without_causes_is_as_it_was(small_rig, readings):
    assert extended_rig(small_rig, fit_of(small_rig, readings)) == small_rig


def test_effects_that_the_rig_had_come_first_and_stay_as_they_were(rig_text, readings):
    block = (
        "effects:\n  sensor_offset[hall]: {x_T: 1e-5, y_T: 0, z_T: 0}\n  current_gain[coil1]: {excess: 0}\n"
    )
    rig = rig_from_text(rig_text + block)
    again = extended_rig(rig, fit_of(rig, readings, CAUSES[0]))
    assert again.effects == (*rig.effects, CAUSES[0])
    assert {name: again.parameters[name] for name in rig.parameters} == rig.parameters
    assert [*again.parameters][: len(rig.parameters)] == [*rig.parameters]


def test_rig_may_be_extended_again_and_again(rig, extended):
    assert extended_rig(rig, extended) == rig


def test_free_effect_that_the_rig_had_keeps_its_value_bounds_and_ties(rig_text, readings):
    block = (
        "effects:\n  current_gain[coil1]:\n"
        "    excess: {prior: {normal: {mean: 0, sd: 0.01, lower: -0.005, upper: 0.005}}}\n"
        "  axis_gain[hall]:\n    x: {prior: {normal: {mean: 0, sd: 0.01}}}\n    y: {tied_to: 'axis_gain[hall].x'}\n    z: 0\n"
    )
    rig = rig_from_text(rig_text + block)
    again = extended_rig(rig, fit_of(rig, readings))
    assert again == rig
    assert again.parameters["current_gain[coil1].excess"].prior == Normal(0.0, 0.01, -0.005, 0.005)

"""The extended rig as a file: it loads, predicts what the fit predicts, and leaves the rest of the rig file alone."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import yaml

from estimator.diagnosis.extension import extended_text
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.readings.observations import Observations
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T

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
def text(small_rig: Rig, extended: Fit) -> str:
    return extended_text(small_rig, extended)


def untied(fit: Fit) -> dict[str, float]:
    return {name: float(v) for name, v in fit.values.items() if fit.rig.parameters[name].tie is None}


def test_extended_file_loads_and_predicts_what_the_fit_predicts(
    text: str, extended: Fit, readings: Observations, tmp_path: Path
):
    """The file keeps the rig's own nominal values; with the fit's in their place nothing differs."""
    path = tmp_path / "rig_extended.yaml"
    path.write_text(text, encoding="utf-8")
    rig = load_rig(path)
    assert rig.effects == CAUSES
    own = {name: value for name, value in untied(extended).items() if "[" not in name}
    torch.testing.assert_close(
        predicted_T(rig.with_values(own), readings),
        predicted_T(extended.rig.with_values(untied(extended)), readings),
        rtol=1e-12,
        atol=1e-18,
    )


def test_extended_rig_is_free_where_the_fit_was_with_the_same_priors(text: str, extended: Fit):
    rig = rig_from_text(text)
    assert [p.name for p in rig.free] == [p.name for p in extended.rig.free]
    assert {p.name: p.prior for p in rig.free} == {p.name: p.prior for p in extended.rig.free}


def test_fitting_the_extended_rig_again_finds_the_same(text: str, extended: Fit, readings: Observations):
    again = fit_rig(rig_from_text(text), readings, {}, extended.posterior.model.rules)
    for name, value in extended.values.items():
        assert float(again.values[name] - value) == pytest.approx(
            0.0, abs=0.02 * extended.value_sd(name) + 1e-15
        )


def test_rest_of_the_file_is_kept_word_by_word(text: str, small_rig: Rig):
    assert text.startswith(small_rig.text)
    assert set(yaml.safe_load(text)) == {*yaml.safe_load(small_rig.text), "effects"}


def test_rig_without_causes_is_the_file_as_it_was(small_rig: Rig, readings: Observations):
    assert extended_text(small_rig, fit_of(small_rig, readings)) == small_rig.text


@pytest.mark.parametrize("where", ["end", "middle"])
def test_effects_that_the_file_had_are_written_once(small_rig: Rig, readings: Observations, where: str):
    block = (
        "effects:\n  sensor_offset[hall]: {x_T: 1e-5, y_T: 0, z_T: 0}\n\n  current_gain[coil1]: {excess: 0}\n"
    )
    before, after = small_rig.text.split("sensors:\n")
    text = f"{before}{block}sensors:\n{after}" if where == "middle" else f"{small_rig.text}{block}"
    rig = rig_from_text(text)
    again = rig_from_text(extended_text(rig, fit_of(rig, readings, CAUSES[0])))
    assert again.effects == (*rig.effects, CAUSES[0])
    assert again.parameters["sensor_offset[hall].x_T"].value == 1e-5
    assert again.sensors == rig.sensors


def test_rig_may_be_extended_again_and_again(text: str, extended: Fit):
    again = extended_text(rig_from_text(text), extended)
    assert rig_from_text(again).effects == CAUSES
    assert again.count("effects:") == 1


def test_comment_of_the_extension_is_written_once(text: str, extended: Fit):
    assert extended_text(rig_from_text(text), extended).count("Found by coilcal diagnose") == 1


def test_comment_at_the_margin_inside_the_effects_does_no_harm(small_rig: Rig, readings: Observations):
    block = (
        "effects:\n  sensor_offset[hall]: {x_T: 1e-5, y_T: 0, z_T: 0}\n# by the maker\n"
        "  current_gain[coil1]: {excess: 0}\n"
    )
    rig = rig_from_text(small_rig.text + block)
    again = rig_from_text(extended_text(rig, fit_of(rig, readings)))
    assert again.effects == rig.effects


def test_bounds_of_a_prior_that_the_file_had_are_kept(small_rig: Rig, readings: Observations):
    block = (
        "effects:\n  current_gain[coil1]:\n"
        "    excess: {prior: {normal: {mean: 0, sd: 0.01, lower: -0.005, upper: 0.005}}}\n"
    )
    rig = rig_from_text(small_rig.text + block)
    again = rig_from_text(extended_text(rig, fit_of(rig, readings)))
    assert again.parameters["current_gain[coil1].excess"].prior == Normal(0.0, 0.01, -0.005, 0.005)


def test_tie_that_the_file_had_is_kept(small_rig: Rig, readings: Observations):
    block = (
        "effects:\n  axis_gain[hall]:\n    x: {prior: {normal: {mean: 0, sd: 0.01}}}\n"
        "    y: {tied_to: 'axis_gain[hall].x'}\n    z: 0\n"
    )
    rig = rig_from_text(small_rig.text + block)
    again = rig_from_text(extended_text(rig, fit_of(rig, readings)))
    assert again.parameters["axis_gain[hall].y"].tie == rig.parameters["axis_gain[hall].y"].tie

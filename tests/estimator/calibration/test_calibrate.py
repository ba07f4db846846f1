"""The main job: it finds the truth, writes what docs/file-formats.md promises, stops, continues and refuses as it says."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.calibration import summary
from estimator.calibration.calibrate import Stage, calibrate
from estimator.calibration.result import Calibration
from estimator.effects.attach import with_effect
from estimator.errors import InvalidInput
from estimator.inference import interpolated
from estimator.inference.ensemble import SamplerSettings
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import simulate
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.emcee_backend import ZarrBackend
from estimator.store.session import Session
from tests.documented import SUMMARY, keys

ERRORS = {"paper_metric_T", "vector_T", "component_T", "max_T", "relative", "angular_deviation_rad"}
DISTANCE = "coil1.world_from_coil0.z_m"
FREE = ["coil1.radius_m", "coil1.world_from_coil0.z_m", "coil1.axial_loops"]
QUICK = SamplerSettings(n_walkers=8, target_ess=100.0, largest_rhat=1.1, check_every=20)


@pytest.fixture(scope="module")
def tiny(small_rig: Rig) -> Rig:
    """Of the small rig, only the distance of the coil is unknown: a second for a calibration."""
    return small_rig.with_values({"coil1.radius_m": 0.0518, "coil1.axial_loops": 13.0}).with_fixed(
        ["coil1.radius_m", "coil1.axial_loops"]
    )


@pytest.fixture(scope="module")
def told() -> list[Stage]:
    return []


@pytest.fixture(scope="module")
def tiny_calibration(small_session: Session, tiny: Rig, told: list[Stage]) -> Calibration:
    return calibrate(small_session, tiny, settings=QUICK, on_stage=told.append)


def test_the_truth_is_found_within_its_intervals(small_calibration, small_truth):
    parameters = small_calibration.summary()["parameters"]
    for name in ("coil1.radius_m", "coil1.world_from_coil0.z_m"):
        numbers = parameters[name]
        assert abs(numbers["median"] - small_truth[name]) < 4 * numbers["sd"]
        assert (
            numbers["sd"] < 0.1 * small_calibration.rig.parameters[name].prior.sd
        )  # the data did it, not the prior
        low, high = numbers["ci90"]
        assert low < numbers["median"] < high
        assert (high - low) == pytest.approx(2 * 1.645 * numbers["sd"], rel=0.2)
    assert parameters["coil1.axial_loops"]["median"] == small_truth["coil1.axial_loops"]


def test_best_values_are_near_the_medians_with_whole_loops(small_calibration):
    parameters = small_calibration.summary()["parameters"]
    assert set(small_calibration.best) == set(small_calibration.rig.parameters)
    for name in FREE:
        assert abs(small_calibration.best[name] - parameters[name]["median"]) <= parameters[name]["sd"]
    assert small_calibration.best["coil1.axial_loops"] == 13.0


OF_UNWOUND = {"amplitudes", "next_degree_log_evidence"}


def test_the_summary_has_the_keys_that_other_peoples_scripts_read(small_calibration):
    record = small_calibration.summary()
    promised = {
        "parameters", "loop_counts", "rmse", "coverage90", "seed", "versions", "session_hash", "rig_hash",
    }  # fmt: skip
    more = {
        "best", "fitted_besides", "has_integer_counts", "is_converged", "notes", "point_estimate", "prior_tension", "quality", "rig_name", "rmse_by_sensor", "rmse_nominal",
        "sampling", "session_created", "session_source", "truth", "undetermined",
    }  # fmt: skip
    assert set(record) == promised | more == set(keys(SUMMARY)) - {"widening", *OF_UNWOUND}
    derived = ["turns", "length_m", "thickness_m", "rms_radius_m"]
    assert set(record["parameters"]) == {*FREE, *(f"coil1.{name}" for name in derived)}
    for name, entry in record["parameters"].items():
        assert set(entry) == {"median", "sd", "ci90", "unit", "ess_bulk", "ess_tail", "rhat", "is_derived"}
        assert entry["unit"] == ("m" if name.endswith("_m") else "1")
        assert entry["is_derived"] == (name not in FREE)
        assert len(entry["ci90"]) == 2
    assert record["loop_counts"]
    for entry in record["loop_counts"]:
        assert set(entry) == {"coil", "axial", "radial", "probability"}
        assert (entry["coil"], entry["radial"], type(entry["axial"])) == ("coil1", 3, int)
    assert sum(entry["probability"] for entry in record["loop_counts"]) == pytest.approx(1.0)
    assert set(record["rmse"]) == set(record["coverage90"]) == {"calibration", "validation"}
    assert set(record["rmse"]["validation"]) == set(record["rmse"]["calibration"]) == ERRORS
    assert {"python", "torch", "emcee", "numpy", "scipy", "zarr", "coilcal"} == set(record["versions"])


def test_derived_quantities_follow_from_the_draws(small_calibration):
    parameters, draws = small_calibration.summary()["parameters"], small_calibration.draws
    pitch_m = 2 * 0.00098
    expected = {
        "coil1.turns": 3 * draws["coil1.axial_loops"],
        "coil1.length_m": pitch_m * draws["coil1.axial_loops"],
        "coil1.thickness_m": np.full_like(draws["coil1.axial_loops"], 3 * pitch_m),
        "coil1.rms_radius_m": np.sqrt(
            np.mean([(draws["coil1.radius_m"] - (n + 0.5) * pitch_m) ** 2 for n in range(3)], axis=0)
        ),
    }
    for name, values in expected.items():
        assert parameters[name]["median"] == pytest.approx(np.median(values))
        assert parameters[name]["sd"] == pytest.approx(values.std(), abs=1e-12)


def test_errors_are_at_the_noise_and_the_nominal_model_is_worse(small_calibration):
    record = small_calibration.summary()
    for role, n in (("calibration", 27), ("validation", 9)):
        errors, nominal = record["rmse"][role], record["rmse_nominal"][role]
        assert errors["component_T"] == pytest.approx(5e-6, rel=4 / math.sqrt(2 * 3 * n))
        assert errors["vector_T"] == pytest.approx(math.sqrt(3) * errors["component_T"])
        assert errors["paper_metric_T"] == 0.5 * errors["vector_T"]
        assert nominal["vector_T"] > 1.5 * errors["vector_T"]
        assert record["rmse_by_sensor"][role] == {"hall": errors}
        assert record["coverage90"][role] == pytest.approx(0.9, abs=4 * math.sqrt(0.09 / (3 * n)))


def test_the_summary_is_json_without_nan(small_calibration):
    def refuse(word: str) -> None:
        raise AssertionError(word)

    text = json.dumps(small_calibration.summary(), allow_nan=False)
    assert json.loads(text, parse_constant=refuse) == small_calibration.summary()
    count = small_calibration.summary()["parameters"]["coil1.thickness_m"]  # it never moves
    assert (count["sd"], count["ess_bulk"], count["rhat"]) == (pytest.approx(0.0, abs=1e-15), None, None)


def test_readings_that_do_not_fit_the_nominal_rig_are_told(small_session, tiny):
    observations = small_session.observations
    reversed_A = replace(observations, current_A=-observations.current_A)
    calibration = calibrate(replace(small_session, observations=reversed_A), tiny, settings=QUICK)
    assert any("point against the rig's nominal model" in note for note in calibration.summary()["notes"])


def test_validation_readings_do_not_touch_the_fit_and_may_be_absent(small_session, tiny, tiny_calibration):
    session = replace(small_session, observations=small_session.observations.calibration)
    record, with_validation = calibrate(session, tiny, settings=QUICK).summary(), tiny_calibration.summary()
    for key in ("rmse", "rmse_nominal", "coverage90"):
        assert record[key]["validation"] is None
        assert record[key]["calibration"] == with_validation[key]["calibration"]
        assert with_validation[key]["validation"] is not None
    assert record["parameters"] == with_validation["parameters"]


def test_the_same_seed_gives_the_same_draws(small_session, tiny, tiny_calibration):
    again = calibrate(small_session, tiny, settings=QUICK)
    assert np.array_equal(again.draws[DISTANCE], tiny_calibration.draws[DISTANCE])
    assert again.summary() == tiny_calibration.summary()


def test_a_large_session_has_the_same_draws_by_interpolation_and_coverage_of_some_readings(
    small_session, tiny, tiny_calibration, monkeypatch
):
    monkeypatch.setattr(interpolated, "FEWEST_COMPONENTS", 1)
    monkeypatch.setattr(summary, "COVERAGE_READINGS", 20)
    large = calibrate(small_session, tiny, settings=QUICK)
    np.testing.assert_allclose(large.draws[DISTANCE], tiny_calibration.draws[DISTANCE], rtol=1e-9)
    np.testing.assert_allclose(
        large.log_prob, tiny_calibration.log_prob, rtol=0.0, atol=interpolated.LARGEST_ERROR
    )
    assert not np.array_equal(large.log_prob, tiny_calibration.log_prob)
    n_inside = 60.0 * large.summary()["coverage90"]["calibration"]
    assert n_inside == pytest.approx(round(n_inside), abs=1e-9)
    assert n_inside == pytest.approx(54.0, abs=4 * math.sqrt(60 * 0.09))


@pytest.mark.parametrize(
    ("cause", "sizes"), [("noise_misstated", {"factor": 3.0}), ("outliers", {"share": 0.1, "ratio": 100.0})]
)
def test_coverage_knows_all_of_the_scatter(small_rig, small_plan, small_truth, cause, sizes):
    hidden = {f"{cause}[hall].{key}": size for key, size in sizes.items()}
    readings = simulate(small_rig, replace(small_plan, repeats=10), small_truth, 5, hidden).calibration.alone
    rig = with_effect(small_rig.with_values(small_truth), Cause(cause, "hall"), readings, sizes, False)
    best = rig.nominal_values()
    draws = {parameter.name: np.full((1, 9), best[parameter.name]) for parameter in rig.free}
    calibration = Calibration(rig, readings, best, draws, np.zeros((1, 9)), {})
    coverage90 = summary.coverage90_of(calibration, MeasurementModel.build(rig, readings), readings)
    assert coverage90 == pytest.approx(0.9, abs=4 * math.sqrt(0.09 / (3 * len(readings))))


def test_real_valued_loops_are_asked_for_by_name(small_session, small_rig):
    rig = small_rig.with_values({"coil1.radius_m": 0.0518}).with_fixed(["coil1.radius_m"])
    calibration = calibrate(small_session, rig, settings=QUICK, has_integer_counts=False)
    loops = calibration.draws["coil1.axial_loops"]
    assert not (loops == np.round(loops)).any()
    record = calibration.summary()
    assert record["loop_counts"] == []
    assert (
        abs(record["parameters"]["coil1.axial_loops"]["median"] - 13.0)
        < 4 * record["parameters"]["coil1.axial_loops"]["sd"]
    )


def test_noise_alone_can_be_calibrated(rig_text, small_session):
    text = rig_text.replace("noise_uT: 5", "noise_uT: {prior: {log_normal: {median: 20, relative_sd: 1}}}")
    values = {"coil1.radius_m": 0.0518, "coil1.axial_loops": 13.0, "coil1.world_from_coil0.z_m": -0.0425}
    rig = rig_from_text(text).with_values(values).with_fixed(values)
    numbers = calibrate(small_session, rig, settings=QUICK).summary()["parameters"]["hall.noise_T"]
    assert abs(numbers["median"] - 5e-6) < 4 * numbers["sd"]
    assert numbers["sd"] == pytest.approx(5e-6 / math.sqrt(2 * 81), rel=0.35)


@pytest.fixture(scope="module")
def uninterrupted(
    small_session: Session, tiny: Rig, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Path]:
    """60 steps whose targets are never met."""
    folder = tmp_path_factory.mktemp("whole") / "result"
    calibrate(small_session, tiny, out=folder, settings=replace(QUICK, target_ess=1e9, max_steps=60))
    return folder


def chain_of(folder: Path) -> np.ndarray:
    return np.asarray(ZarrBackend.open(folder / "chain.zarr").get_chain())


def test_a_run_that_ends_early_says_so_and_continues_when_more_steps_are_allowed(
    small_session, tiny, uninterrupted, tmp_path
):
    never = replace(QUICK, target_ess=1e9)
    short = calibrate(small_session, tiny, out=tmp_path, settings=replace(never, max_steps=30))
    assert short.summary()["is_converged"] is False
    assert Calibration.load(tmp_path).summary()["sampling"]["steps"] == 30
    completed = calibrate(small_session, tiny, out=tmp_path, settings=replace(never, max_steps=60))
    assert np.array_equal(chain_of(tmp_path), chain_of(uninterrupted))
    assert (
        Calibration.load(tmp_path).summary()
        == Calibration.load(uninterrupted).summary()
        == completed.summary()
    )
    fewer = calibrate(small_session, tiny, out=tmp_path, settings=replace(never, max_steps=20))
    assert fewer.summary()["sampling"]["steps"] == 60  # steps that exist are not thrown away


def test_an_unfinished_run_of_something_else_is_kept(small_session, tiny, uninterrupted):
    before = chain_of(uninterrupted)
    never = replace(QUICK, target_ess=1e9)
    for changed in (
        {"seed": 3},
        {"settings": replace(never, n_walkers=12)},
        {"rig": tiny.with_values({"hall.noise_T": 4e-6})},
    ):
        arguments = {"rig": tiny, "settings": never, **changed}
        with pytest.raises(
            InvalidInput,
            match="output must be empty, hold an unfinished calibration of the same session, rig, seed",
        ):
            calibrate(small_session, out=uninterrupted, **arguments)
    assert np.array_equal(chain_of(uninterrupted), before)


def test_a_finished_calibration_is_replaced_only_when_asked(small_session, tiny, tiny_calibration, tmp_path):
    tiny_calibration.save(tmp_path)
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InvalidInput, match="output must not hold a finished calibration unless --overwrite"):
        calibrate(small_session, tiny, out=tmp_path, settings=QUICK, seed=1)
    few = replace(QUICK, n_walkers=2)
    with pytest.raises(
        InvalidInput, match="walkers must be at least"
    ):  # nothing is deleted for a run that cannot start
        calibrate(small_session, tiny, out=tmp_path, overwrite=True, settings=few, seed=1)
    assert Calibration.load(tmp_path).summary() == json.loads(json.dumps(tiny_calibration.summary()))
    calibrate(small_session, tiny, out=tmp_path, overwrite=True, settings=QUICK, seed=1)
    replaced = Calibration.load(tmp_path)
    assert replaced.summary()["seed"] == 1
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "mine"
    # Another seed gives other draws of the same posterior.
    assert not np.array_equal(replaced.draws[DISTANCE], tiny_calibration.draws[DISTANCE])
    first, second = (c.summary()["parameters"][DISTANCE] for c in (tiny_calibration, replaced))
    assert abs(first["median"] - second["median"]) < 5 * 1.25 * first["sd"] * math.sqrt(2 / QUICK.target_ess)


def fixed(text: str) -> str:
    for prior, value in (("mean: 51, sd: 1", "51"), ("mean: -40, sd: 3", "-40")):
        text = text.replace(f"{{prior: {{normal: {{{prior}}}}}}}", value)
    return text


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (
            lambda text: fixed(text).replace("{prior: {normal: {mean: 12, sd: 1, lower: 1}}}", "12"),
            {},
            r"rig must have at least one free parameter \(a prior\); rig 'small' has none",
        ),
        (fixed, {}, "rig must have a free parameter besides loop counts"),
        (str, {"seed": -1}, "seed must be a whole number from 0 to 4294967295; received -1"),
        (str, {"seed": 2**32}, "seed must be a whole number from 0 to 4294967295; received 4294967296"),
    ],
)
def test_what_cannot_be_calibrated_is_refused_before_anything_is_written(
    small_session, rig_text, tmp_path, change, arguments, message
):
    with pytest.raises(InvalidInput, match=message):
        calibrate(small_session, rig_from_text(change(rig_text)), out=tmp_path / "out", **arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("target_ess", 0.0),
        ("target_ess", float("nan")),
        ("largest_rhat", -1.0),
        ("max_steps", 0),
        ("check_every", -1),
    ],
)
def test_senseless_settings_are_refused(name, value):
    with pytest.raises(InvalidInput, match=f"sampler settings: {name} must be > 0; received"):
        SamplerSettings(**{name: value})


def test_readings_in_another_unit_or_too_few_are_refused(small_session, tmp_path):
    o = small_session.observations
    for observations, message in (
        (o.with_field(1e3 * o.field_sensor_T), r"fields look like mT .*\(simulated\)"),
        (o.rows(torch.arange(1)), "received a single reading"),
    ):
        with pytest.raises(InvalidInput, match=message):
            calibrate(replace(small_session, observations=observations), out=tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_validation_sensor_inside_the_winding_is_refused_before_the_work(small_session, tmp_path):
    o = small_session.observations
    motion = o.motion["arm1"].clone()
    motion[30, :3] = torch.tensor([0.048, 0.0, 0.05])
    session = replace(small_session, observations=replace(o, motion={"arm1": motion}))
    with pytest.raises(
        InvalidInput, match=r"sensors must lie outside the winding of coil1; .* the first at reading 30"
    ):
        calibrate(session, out=tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_errors_are_of_the_calibrated_winding_however_far_the_rig_file_has_it(
    small_session, small_calibration
):
    """The quadrature is as fine as the place of the fit asks: chosen for a coil 1 m away, it would miss by 1 uT."""
    away = small_calibration.rig.with_values({"coil1.world_from_coil0.z_m": -1.0})
    moved = summary.summary(small_session, replace(small_calibration, rig=away))["rmse"]
    for role, errors in small_calibration.summary()["rmse"].items():
        assert moved[role]["max_T"] == pytest.approx(errors["max_T"], rel=1e-3)

"""`coilcal init`: what it writes passes at once, with and without questions."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from drivers.limits_section import limits_of
from estimator.cli import init
from estimator.cli.init import asked_of
from estimator.cli.main import main
from estimator.cli.simulated_devices import default_devices
from estimator.model.room_field import RoomField
from estimator.model.simulate import draw_truth, simulate
from estimator.readings.plan import load_plan, observations_of, plan_from_text
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.set_ups import Kind, texts_of
from estimator.rig_files.starter import Motion, Moved, Starter, starter_plan_text, starter_rig_text
from tests.estimator.cli.conftest import run


@pytest.mark.parametrize("kind", Kind)
def test_each_set_up_can_be_simulated_and_keeps_sensors_out_of_windings(kind):
    rig_text, plan_text = texts_of(kind, {"earth": "subtracted"})
    rig = rig_from_text(rig_text)
    plan = plan_from_text(plan_text, rig)
    for seed in range(3):
        readings = simulate(rig, plan, draw_truth(rig, seed), seed)
        assert readings.is_validation.any()
        assert float(readings.field_sensor_T.abs().max()) > 1e-4
    assert not any("background" in name for name in rig.parameters)
    assert "background_field[room].x_T" in rig_from_text(texts_of(kind, {})[0]).parameters


def test_a_pair_and_a_cage_are_flat_in_the_middle_and_a_maxwell_pair_is_steep():
    def along_T(kind: Kind, currents_A: dict[str, float], axis: int) -> np.ndarray:
        rig = rig_from_text(texts_of(kind, {})[0])
        points_m = torch.zeros(5, 3, dtype=torch.float64)
        points_m[:, axis] = torch.linspace(-0.02, 0.02, 5)
        values = {n: torch.tensor(v, dtype=torch.float64) for n, v in rig.nominal_values().items()}
        room = RoomField(rig, values, points_m)
        current_A = torch.tensor([currents_A.get(coil.name, 0.0) for coil in rig.coils], dtype=torch.float64)
        return room.field_T(values, current_A)[:, axis].numpy()

    flat = [along_T(Kind.HELMHOLTZ, {"coil1": 1.0, "coil2": 1.0}, 2)]
    flat += [along_T(Kind.CAGE, {f"{name}1": 1.0, f"{name}2": 1.0}, axis) for axis, name in enumerate("xyz")]
    for field_T in flat:
        assert np.ptp(field_T) < 2e-3 * field_T.mean() > 0.0
    steep_T = along_T(Kind.MAXWELL, {"coil1": 1.0, "coil2": -1.0}, 2)
    assert abs(steep_T[2]) < 1e-9
    np.testing.assert_allclose(np.diff(steep_T), np.diff(steep_T).mean(), rtol=2e-3)


def test_an_answer_that_is_refused_is_asked_again_and_the_others_stay(monkeypatch, tmp_path):
    monkeypatch.setattr(init, "can_ask", lambda: True)
    # The wire is refused at once; that the radius leaves no bore and that the stage goes too far shows at the end.
    answers = "helmholtz,our pair,20,-1,0.4,12,9,100,,,subtracted,120,30,"
    result = CliRunner().invoke(main, ["init", str(tmp_path)], input=answers.replace(",", "\n"))
    assert result.exit_code == 0, result.stderr
    assert "wire_radius_mm must be > 0 and below 1000000; received -1" in result.stderr
    assert "radius_mm must leave a bore in which a sensor can be moved" in result.stderr
    assert "reach_mm must be at most" in result.stderr
    rig = load_rig(tmp_path / "rig.yaml")
    values = rig.nominal_values()
    assert (rig.name, values["coil1.axial_loops"], values["coil2.radial_loops"]) == ("our pair", 12.0, 9.0)


@pytest.mark.parametrize(("moved", "motion"), list(itertools.product(Moved, Motion)))
def test_whatever_is_moved_no_draw_of_the_truth_puts_a_sensor_into_the_winding(moved, motion):
    starter = Starter(moved=moved, motion=motion, distance_mm=14.0)
    assert starter.distance_mm - starter.nearest_mm < 1.5
    rig = rig_from_text(starter_rig_text(starter))
    plan = plan_from_text(starter_plan_text(starter), rig)
    for seed in range(3):
        readings = simulate(rig, plan, draw_truth(rig, seed), seed)
        assert len(readings) == 280
        assert int(readings.is_validation.sum()) == 60
        assert float(readings.field_sensor_T.abs().max()) > 1e-3


def test_a_script_is_not_asked_and_gets_what_it_gave(tmp_path):
    given = "--radius-mm 20 --radial-loops 8 --largest-a 1.5 --noise-ut 3 --json"
    result = run("init", tmp_path / "new", *given.split(), "--name", "small coil")
    told = json.loads(result.stdout)
    assert (result.exit_code, result.stderr, told["readings"]) == (0, "", 280)
    rig = load_rig(told["rig"])
    assert rig.name == "small coil"
    assert rig.nominal_values()["coil1.radius_m"] == pytest.approx(0.02)
    assert rig.nominal_values()["hall.noise_T"] == pytest.approx(3e-6)
    assert len(rig.free) == told["free"] == 19
    checked = run("check", told["rig"], told["plan"])
    assert checked.stdout.endswith("no mistake found\n")
    again = run("init", tmp_path / "new")
    assert (again.exit_code, again.stdout) == (2, "")
    assert "must not exist yet, or be replaced with --overwrite" in again.stderr


def test_an_option_of_another_set_up_is_refused_with_those_that_it_takes(tmp_path):
    result = run("init", tmp_path / "new", "--kind", "helmholtz", "--moved", "sensor")
    assert result.exit_code == 2
    told = "--moved is no answer for --kind helmholtz, which takes --name, --radius-mm, --wire-radius-mm, "
    assert told in result.stderr
    assert "--distance-mm" not in result.stderr


def test_a_word_that_is_the_name_of_the_folder_too_is_no_path_that_is_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for more in ([], ["--overwrite"]):
        assert run("init", "solenoid", "--kind", "solenoid", "--name", "solenoid", *more).exit_code == 0


def test_whoever_sits_at_a_terminal_is_asked_for_the_rest(monkeypatch, tmp_path):
    monkeypatch.setattr(init, "can_ask", lambda: True)
    of_rest = [""] * (len(asked_of("stage")) - 4)
    answers = ["", "bench", "sensor", "shift", "pose", *of_rest]  # "shift" is asked again
    arguments = ["init", str(tmp_path), "--radius-mm", "30"]
    result = CliRunner().invoke(main, arguments, input="\n".join(answers) + "\n")
    assert result.exit_code == 0
    assert "Name of the rig [my rig]" in result.stderr
    assert "Outer radius" not in result.stderr
    rig = load_rig(tmp_path / "rig.yaml")
    assert (rig.name, rig.movers[0].motion, rig.sensors[0].carried_by) == ("bench", "pose", "arm1")
    assert rig.nominal_values()["coil1.radius_m"] == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--radius-mm", "-1"], "radius_mm must be > 0 and below 1000000; received -1"),
        (["--noise-ut", "nan"], "--noise-ut must be a number"),
        (
            ["--radius-mm", "20"],
            "radius_mm must exceed 24.74, the thickness of its layers and some room; received 20",
        ),
        (
            ["--distance-mm", "10"],
            "distance_mm from the front face of the coil must be at least 13.74, so that no sensor comes into the winding",
        ),
        (["--name", "a: b"], "name must consist of letters, digits, _, - and blanks; received 'a: b'"),
        (["--axial-loops", "0"], "axial_loops must be at least 1 and below 10000; received 0"),
    ],
)
def test_answers_that_make_no_sense_leave_no_file(tmp_path, options, words):
    result = run("init", tmp_path / "new", *options)
    assert result.exit_code == 2
    assert words in result.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["null", "3", "yes"])
def test_a_name_stays_a_name(name):
    assert rig_from_text(starter_rig_text(Starter(name=name))).name == name


def test_a_decimal_comma_is_read_and_what_may_be_thousands_is_refused(tmp_path):
    options = ["--kind", "helmholtz", "--yes"]
    done = CliRunner().invoke(main, ["init", str(tmp_path / "comma"), *options, "--radius-mm", "209,35"])
    assert done.exit_code == 0
    assert "mean: 209.35," in (tmp_path / "comma/rig.yaml").read_text()
    refused = CliRunner().invoke(main, ["init", str(tmp_path / "other"), *options, "--radius-mm", "1,000"])
    assert refused.exit_code == 2
    assert "1,000" in refused.stderr


@pytest.mark.parametrize("kind", ["arm", "helmholtz"])
def test_simulated_arms_reach_what_the_first_plan_visits(tmp_path, kind):
    """Poses are in the base, so their workspace lies about the origin of the room and not where an arm likes to stand."""
    assert CliRunner().invoke(main, ["init", str(tmp_path), "--kind", kind, "--yes"]).exit_code == 0
    rig = load_rig(tmp_path / "rig.yaml")
    (mover,) = rig.movers
    limits = limits_of(default_devices(rig)).arms[mover.name]
    plan = load_plan(tmp_path / "plan.yaml", rig)
    visited_m = observations_of(plan, rig, np.random.default_rng(0)).motion[mover.name][:, :3]
    assert (visited_m >= torch.tensor(limits.lowest_m)).all()
    assert (visited_m <= torch.tensor(limits.highest_m)).all()

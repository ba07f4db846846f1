"""`coilcal init`: what it writes passes at once, with and without questions."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from estimator.cli import init
from estimator.cli.init import QUESTIONS
from estimator.cli.main import main
from estimator.errors import InvalidInput
from estimator.model.simulate import draw_truth, simulate
from estimator.readings.plan import plan_from_text
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.starter import Motion, Moved, Starter, starter_plan_text, starter_rig_text

Run = Callable[..., Result]


def test_each_question_is_a_field_of_the_starter_with_its_default() -> None:
    assert {key: default for key, (_, default, _) in QUESTIONS.items()} == {
        field.name: field.default for field in fields(Starter)
    }
    assert list(QUESTIONS["moved"][0]) == list(Moved)
    assert list(QUESTIONS["motion"][0]) == list(Motion)


@pytest.mark.parametrize(("moved", "motion"), list(itertools.product(Moved, Motion)))
def test_whatever_is_moved_no_draw_of_the_truth_puts_a_sensor_into_the_winding(
    moved: Moved, motion: Motion
) -> None:
    starter = Starter(moved=moved, motion=motion, distance_mm=14.0)
    assert starter.distance_mm - starter.nearest_mm < 1.5
    rig = rig_from_text(starter_rig_text(starter))
    plan = plan_from_text(starter_plan_text(starter), rig)
    for seed in range(3):
        readings = simulate(rig, plan, draw_truth(rig, seed), seed)
        assert len(readings) == 280
        assert int(readings.is_validation.sum()) == 60
        assert float(readings.field_sensor_T.abs().max()) > 1e-3


def test_a_script_is_not_asked_and_gets_what_it_gave(run: Run, tmp_path: Path) -> None:
    given = [
        "--radius-mm",
        20,
        "--radial-loops",
        8,
        "--name",
        "small coil",
        "--largest-a",
        1.5,
        "--noise-ut",
        3,
    ]
    result = run("init", tmp_path / "new", *given, "--json")
    told = json.loads(result.stdout)
    assert (result.exit_code, result.stderr, told["readings"]) == (0, "", 280)
    rig = load_rig(told["rig"])
    assert rig.name == "small coil"
    assert rig.nominal_values()["coil1.radius_m"] == pytest.approx(0.02)
    assert rig.nominal_values()["hall.noise_T"] == pytest.approx(3e-6)
    assert len(rig.free) == told["free"] == 19
    checked = run("check", told["rig"], told["plan"])
    assert checked.stdout.endswith("nothing is wrong\n")
    again = run("init", tmp_path / "new")
    assert (again.exit_code, again.stdout) == (2, "")
    assert "must not exist yet, or be replaced with --overwrite" in again.stderr


def test_whoever_sits_at_a_terminal_is_asked_for_the_rest(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(init, "can_ask", lambda: True)
    answers = ["bench", "sensor", "shift", "pose", *[""] * (len(QUESTIONS) - 4)]  # "shift" is asked again
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
def test_answers_that_make_no_sense_leave_no_file(
    run: Run, tmp_path: Path, options: list[str], words: str
) -> None:
    result = run("init", tmp_path / "new", *options)
    assert result.exit_code == 2
    assert words in result.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["null", "3", "yes"])
def test_a_name_stays_a_name(name: str) -> None:
    assert rig_from_text(starter_rig_text(Starter(name=name))).name == name


def test_a_starter_without_room_is_refused() -> None:
    with pytest.raises(InvalidInput, match="distance_mm from the front face of the coil must be at least"):
        Starter(radius_mm=400)


@pytest.mark.slow
def test_what_it_writes_can_be_calibrated_at_once(run: Run, tmp_path: Path) -> None:
    assert run("init", tmp_path).exit_code == 0
    rig, plan, session = tmp_path / "rig.yaml", tmp_path / "plan.yaml", tmp_path / "trial.zarr"
    assert run("simulate", "--rig", rig, "--plan", plan, "--out", session).exit_code == 0
    result = run("calibrate", session, "--out", tmp_path / "trial", "--ess", 200)
    assert result.exit_code == 0
    assert result.stdout.startswith("good: ")

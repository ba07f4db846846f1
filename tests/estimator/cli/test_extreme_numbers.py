"""Numbers at the ends of what a number can be, in every option of every command: a result, or one sentence."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest
from click.testing import Result

from estimator.cli.main import main
from tests.estimator.cli.conftest import refused, run

EXTREMES = ["1e300", "-1e300", "1e13", "inf", "-inf", "nan", "1e999", "9" * 400, "9" * 5000]
ALLOWED = ["1e12", "-1e12", "1e-300", "5e-324", "-0.0"]
GRID, CURRENT = ("--grid", "x_mm=5"), ("--current", "coil1=2")
MOTION = ("--motion", "arm1=0.01,0,0,0,0,0")


def numeric_options(
    command: click.Command, name: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Parameter]]:
    """Every option of a number, with the words of its command."""
    if isinstance(command, click.Group):
        for below in command.commands.values():
            yield from numeric_options(below, (*name, below.name or ""))
    for option in command.params:
        if isinstance(option.type, click.types.FloatParamType | click.types.IntParamType):
            yield name, option


OPTIONS = [
    pytest.param(name, option, id=" ".join((*name, option.opts[0]))) for name, option in numeric_options(main)
]


@pytest.mark.parametrize(("name", "option"), OPTIONS)
@pytest.mark.parametrize("value", EXTREMES)
def test_every_option_of_a_number_refuses_what_no_calculation_takes(
    name, option, value, tmp_path, monkeypatch
):
    """The other arguments are nonsense that comes after the numbers, so nothing is calculated, served or measured."""
    if float(value) == option.default:
        pytest.skip("no limit, as where it is left out")
    monkeypatch.chdir(tmp_path)
    command: click.Command = main
    for word in name:
        assert isinstance(command, click.Group)
        command = command.commands[word]
    others = [
        argument
        for each in command.params
        if each.required and each is not option
        for argument in given(each)
    ]
    result = (
        run(*(name or ("show", "none")), *others, option.opts[0], value)
        if name
        else run(option.opts[0], value, "show", "none")
    )
    assert_one_sentence(result)
    assert option.opts[0] in result.stderr
    assert len(result.stderr) < 700
    assert list(tmp_path.iterdir()) == []


def given(option: click.Parameter) -> list[str]:
    """Nonsense for an argument or option that must be there."""
    return ["none"] if isinstance(option, click.Argument) else [option.opts[0], "none"]


def assert_one_sentence(result: Result) -> None:
    assert result.exit_code == 2, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.output


@pytest.mark.parametrize("value", EXTREMES)
@pytest.mark.parametrize(
    "call",
    [
        (*GRID, *CURRENT, "--motion", "arm1=0.01,0,0,0,0,{}"),
        (*GRID, *CURRENT, "--motion", "arm1={},0,0,0,0,0"),
        (*GRID, *MOTION, "--current", "coil1={}"),
        (*CURRENT, *MOTION, "--grid", "x_mm={}"),
        (*CURRENT, *MOTION, "--grid", "x_mm=0:{}:2"),
        (*CURRENT, *MOTION, "--grid", "x_mm=0:1:{}"),
    ],
    ids=" ".join,
)
def test_no_number_of_a_prediction_ends_in_a_traceback(workspace, tmp_path, call, value):
    out = tmp_path / "field.csv"
    result = run(
        "predict", workspace / "calibration", "--out", out, *(word.replace("{}", value) for word in call)
    )
    assert_one_sentence(result)
    assert result.stderr.count("\n") == 1
    assert len(result.stderr) < 300
    assert not out.exists()


@pytest.mark.parametrize("value", ALLOWED)
@pytest.mark.parametrize("where", ["motion", "turn", "current", "grid"])
def test_the_largest_and_smallest_numbers_that_are_taken_give_a_field_or_a_sentence(
    workspace, tmp_path, where, value
):
    words = {
        "motion": (*GRID, *CURRENT, "--motion", f"arm1={value},0,0,0,0,0"),
        "turn": (*GRID, *CURRENT, "--motion", f"arm1=0,0,0,0,{value},0"),
        "current": (*GRID, *MOTION, "--current", f"coil1={value}"),
        "grid": (*CURRENT, *MOTION, "--grid", f"x_mm={value}"),
    }
    result = run("predict", workspace / "calibration", "--out", tmp_path / "field.csv", *words[where])
    assert result.exit_code in (0, 2), result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)


@pytest.mark.parametrize("option", ["--set", "--hide"])
@pytest.mark.parametrize("value", EXTREMES)
def test_no_number_of_a_truth_ends_in_a_traceback(simulate, tmp_path, option, value):
    name = "coil1.radius_m" if option == "--set" else "sensor_offset[hall].x"
    result = simulate("--out", tmp_path / "new.zarr", option, f"{name}={value}")
    assert len(refused(result)) < 300

"""`coilcal init`: a commented rig file and plan to begin with, from a few questions or from options."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from estimator.cli.options import OutputPath, json_option, overwrite_option
from estimator.cli.output import CoilcalCommand, show

QUESTIONS: dict[str, tuple[type | tuple[str, ...], Any, str]] = {
    "name": (str, "my rig", "Name of the rig"),
    "moved": (("coil", "sensor"), "coil", "What the robot or stage carries; the other one stands still"),
    "motion": (
        ("displacement", "pose"),
        "displacement",
        "What its readings say: how far it went since a reference position, or its position and rotation",
    ),
    "radius_mm": (float, 48.0, "Outer radius of the coil in mm, over the insulation"),
    "wire_radius_mm": (float, 0.46, "Radius of the wire in mm, insulation included"),
    "axial_loops": (float, 45.0, "Turns along the axis"),
    "radial_loops": (float, 22.0, "Layers of turns"),
    "distance_mm": (
        float,
        40.0,
        "Distance in mm, along the axis, of the sensor from the front face of the coil where they are nearest",
    ),
    "reach_mm": (float, 40.0, "How far the robot or stage goes to each side, and away, in mm"),
    "noise_uT": (float, 20.0, "Scatter of one reading of the sensor in uT"),
    "largest_A": (float, 3.0, "Largest current in A"),
}  # of `estimator.rig_files.starter.Starter`, which needs torch; a test holds both together


def _options(command: Callable[..., Any]) -> Callable[..., Any]:
    """One option for each question."""
    for key, (kind, default, words) in reversed(QUESTIONS.items()):
        command = click.option(
            f"--{key.replace('_', '-').lower()}",
            key,
            type=click.Choice(list(kind)) if isinstance(kind, tuple) else kind,
            help=f"{words}.  [default: {default}]",
        )(command)
    return command


@click.command("init", cls=CoilcalCommand)
@click.argument("folder", default=".", type=OutputPath(is_filled=True))
@_options
@click.option("--yes", "is_quiet", is_flag=True, help="Ask nothing: take the defaults of what is not given.")
@overwrite_option
@json_option
def init_command(folder: Path, is_quiet: bool, overwrite: bool, as_json: bool, **given: Any) -> None:
    """Write rig.yaml and plan.yaml into FOLDER, commented, for one coil, one sensor and what moves.

    What no option gives is asked for; where nobody can answer, as in a script, the default counts.
    """
    from estimator.cli.understood import plan_record
    from estimator.readings.plan import plan_from_text
    from estimator.rig_files.read import rig_from_text
    from estimator.rig_files.starter import (
        Motion,
        Moved,
        Starter,
        check_name,
        starter_plan_text,
        starter_rig_text,
    )
    from estimator.store.staging import check_output, only_writer, write_output

    rig_path, plan_path = folder / "rig.yaml", folder / "plan.yaml"
    for path in (rig_path, plan_path):
        check_output(path, overwrite)
    answers = {key: _answer(key, given[key], is_quiet or as_json) for key in QUESTIONS}
    named = {
        "name": check_name(answers["name"]),
        "moved": Moved(answers["moved"]),
        "motion": Motion(answers["motion"]),
    }
    starter = Starter(**{**answers, **named})
    rig_text, plan_text = starter_rig_text(starter), starter_plan_text(starter)
    rig = rig_from_text(rig_text, str(rig_path))
    plan = plan_from_text(plan_text, rig, str(plan_path))
    with only_writer(folder):
        write_output(rig_path, rig_text, overwrite)
        write_output(plan_path, plan_text, overwrite)
    n_readings = plan_record(plan, rig)["readings"]
    result = {"rig": str(rig_path), "plan": str(plan_path), "readings": n_readings, "free": len(rig.free)}
    show(result, _text(folder, rig_path, plan_path, n_readings, len(rig.free)), as_json)


def _answer(key: str, given: Any, is_quiet: bool) -> Any:
    """What an option gave, the user answers, or the default."""
    kind, default, words = QUESTIONS[key]
    if given is not None:
        return given
    if is_quiet or not can_ask():
        return default
    choices = click.Choice(list(kind)) if isinstance(kind, tuple) else kind
    return click.prompt(words, default=default, type=choices, err=True)


def can_ask() -> bool:
    """Whether somebody sits at the terminal."""
    return sys.stdin.isatty()


def _text(folder: Path, rig: Path, plan: Path, n_readings: int, n_free: int) -> str:
    session = folder / "trial.zarr"
    return f"""{rig} and {plan} written: {n_free} free numbers, {n_readings} readings. Edit them, then:
  coilcal check {rig} {plan}
  coilcal simulate --rig {rig} --plan {plan} --out {session}      # what a session would give
  coilcal calibrate {session} --out {folder / "trial"}"""

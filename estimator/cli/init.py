"""`coilcal init`: a commented rig file and plan to begin with, from a few questions or from options."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from estimator.cli.options import OutputPath, flag, option, result_options
from estimator.cli.output import CoilcalCommand, show
from estimator.errors import InvalidInput

KINDS = {
    "stage": "one coil and one sensor, a stage carries one of them",
    "arm": "the same with an arm that reports poses",
    "helmholtz": "two coils whose currents flow alike, a stage maps their middle",
    "maxwell": "two coils whose currents oppose each other, a stage maps their middle",
    "cage": "three pairs of square coils, a stage maps their middle",
    "array": "several fixed sensors, a stage carries a coil before them",
    "solenoid": "a long coil, a mapper carries a sensor through it",
}
QUESTIONS: dict[str, tuple[type | tuple[str, ...], str]] = {
    "name": (str, "Name of the rig"),
    "moved": (("coil", "sensor"), "What the robot or stage carries; the other one stands still"),
    "motion": (
        ("displacement", "pose"),
        "What its readings say: how far it went since a reference position, or its position and rotation",
    ),
    "radius_mm": (float, "Outer radius of the coil in mm, over the insulation"),
    "side_mm": (float, "Inner side of the largest pair in mm"),
    "n_sensors": (int, "Sensors of the array"),
    "spacing_mm": (float, "Distance of neighbouring sensors in mm"),
    "wire_radius_mm": (float, "Radius of the wire in mm, insulation included"),
    "axial_loops": (float, "Turns along the axis"),
    "radial_loops": (float, "Layers of turns"),
    "distance_mm": (
        float,
        "Distance in mm, along the axis, of the sensor from the front face of the coil where they are nearest",
    ),
    "reach_mm": (float, "How far the robot or stage goes to each side, and away, in mm"),
    "noise_uT": (float, "Scatter of one reading of the sensor in uT"),
    "largest_A": (float, "Largest current in A"),
    "earth": (
        ("included", "subtracted"),
        "The Earth's field, 25 to 65 uT: is it in the readings, or was it subtracted",
    ),
}


class _Number(click.types.FloatParamType):
    """A number with a decimal point or a decimal comma; a comma before three digits may separate thousands, and is refused."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number that a text says."""
        if isinstance(value, str) and re.fullmatch(r"\s*[+-]?\d+,(\d{1,2}|\d{4,})\s*", value):
            value = value.replace(",", ".")
        return super().convert(value, param, ctx)


def _type_of(kind: type | tuple[str, ...]) -> Any:
    """What the options and the answers to a question are read by."""
    if isinstance(kind, tuple):
        return click.Choice(list(kind))
    return _Number() if kind is float else kind


def _flag(key: str) -> str:
    """The option that answers a question."""
    return f"--{key.replace('_', '-').lower()}"


def _options(command: Callable[..., Any]) -> Callable[..., Any]:
    """One option for each question."""
    for key, (kind, words) in reversed(QUESTIONS.items()):
        command = click.option(
            _flag(key),
            key,
            type=_type_of(kind),
            help=f"{words}.",
        )(command)
    return option(
        "--kind",
        "Set-up to begin with: "
        + "; ".join(f"{kind}: {words}" for kind, words in KINDS.items())
        + ".  [default: stage]",
        click.Choice(list(KINDS)),
    )(command)


@click.command("init", cls=CoilcalCommand)
@click.argument("folder", default=".", type=OutputPath(is_filled=True))
@_options
@flag("--yes is_quiet", "Ask nothing: take the defaults of what is not given.")
@result_options
def init_command(
    folder: Path, kind: str | None, is_quiet: bool, overwrite: bool, as_json: bool, **given: Any
) -> None:
    """Write rig.yaml and plan.yaml into FOLDER, commented, for a common set-up.

    What no option gives is asked for; where nobody can answer, as in a script, the default counts. An answer that is refused is asked
    again, and all others stay.
    """
    from estimator.cli.understood import plan_record
    from estimator.readings.plan import plan_from_text
    from estimator.rig_files.read import rig_from_text
    from estimator.store.staging import check_output, only_writer, write_output

    rig_path, plan_path = folder / "rig.yaml", folder / "plan.yaml"
    for path in (rig_path, plan_path):
        check_output(path, overwrite)
    is_asked = not (is_quiet or as_json) and can_ask()
    kind = kind or (_asked_kind() if is_asked else "stage")
    given = {key: value for key, value in given.items() if value is not None}
    asked = asked_of(kind)
    for key in given:
        if key not in asked:
            raise InvalidInput(
                f"{_flag(key)} is no answer for --kind {kind}, which takes {', '.join(map(_flag, asked))}"
            )
    rig_text, plan_text = _texts(kind, given, is_asked)
    rig = rig_from_text(rig_text, str(rig_path))
    plan = plan_from_text(plan_text, rig, str(plan_path))
    with only_writer(folder):
        write_output(rig_path, rig_text, overwrite)
        write_output(plan_path, plan_text, overwrite)
    n_readings = plan_record(plan, rig)["readings"]
    result = {
        "kind": kind,
        "rig": str(rig_path),
        "plan": str(plan_path),
        "readings": n_readings,
        "free": len(rig.free),
    }
    show(result, _text(folder, rig_path, plan_path, n_readings, len(rig.free)), as_json)


def _asked_kind() -> str:
    for kind, words in KINDS.items():
        click.echo(f"  {kind:10} {words}", err=True)
    return click.prompt("Set-up", default="stage", type=click.Choice(list(KINDS)), err=True)


def asked_of(kind: str) -> list[str]:
    """What a set-up asks for, in the order of the questions: what it has defaults of. An array always has its coil on a stage."""
    from estimator.rig_files.set_ups import Kind, defaults_of

    known = defaults_of(Kind(kind)).keys() - ({"moved", "motion"} if kind == "array" else set())
    return [key for key in QUESTIONS if key in known]


def _texts(kind: str, given: dict[str, Any], is_asked: bool) -> tuple[str, str]:
    """Rig file and plan; at a terminal an answer that is refused is asked again."""
    from estimator.rig_files.set_ups import Kind, defaults_of, texts_of
    from estimator.rig_files.starter import check_answer

    answers, defaults, asked = dict(given), defaults_of(Kind(kind)), asked_of(kind)
    if not is_asked:
        return texts_of(Kind(kind), answers)
    while True:
        for key in (key for key in asked if key not in answers):
            answers[key] = _answer(key, defaults[key], check_answer)
        try:
            return texts_of(Kind(kind), answers)
        except InvalidInput as refusal:
            key = str(refusal).partition(" ")[0]
            if key not in answers:
                raise
            click.echo(f"  {refusal}", err=True)
            defaults[key] = answers.pop(key)


def _answer(key: str, default: Any, check: Callable[[str, Any], None]) -> Any:
    """The user's answer; asked again until it is possible."""
    kind, words = QUESTIONS[key]
    while True:
        answer = click.prompt(words, default=default, type=_type_of(kind), err=True)
        try:
            check(key, answer)
        except InvalidInput as refusal:
            click.echo(f"  {refusal}", err=True)
        else:
            return answer


def can_ask() -> bool:
    """Whether standard input is a terminal."""
    return sys.stdin.isatty()


def _text(folder: Path, rig: Path, plan: Path, n_readings: int, n_free: int) -> str:
    session = folder / "trial.zarr"
    return f"""{rig} and {plan} written: {n_free} free numbers, {n_readings} readings. Edit them, then:
  coilcal check {rig} {plan}
  coilcal simulate --rig {rig} --plan {plan} --out {session}      # what a session would give
  coilcal calibrate {session} --out {folder / "trial"}
Your own readings, as they are (coilcal docs import-your-data):
  coilcal import readings.csv --rig {rig} --out {folder / "session.zarr"}"""

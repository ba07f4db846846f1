"""`coilcal simulate`: a session whose true parameters are known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from estimator.cli.named import named_number
from estimator.cli.options import (
    PATH,
    OutputPath,
    hide_option,
    option,
    result_options,
    seed_option,
    set_option,
    truth_option,
)
from estimator.cli.output import CoilcalCommand, show
from estimator.errors import InvalidInput, quoted
from estimator.given_files import MOST_SETTINGS_BYTES, read_given
from estimator.json_files import json_object
from estimator.units import LARGEST

if TYPE_CHECKING:
    from estimator.rig.rig import Rig


@click.command("simulate", cls=CoilcalCommand, takes_derivatives=False)
@option("--rig rig_path", "Rig file.", PATH, required=True)
@option("--plan plan_path", "Plan file: poses and currents to visit.", PATH, required=True)
@truth_option("prior")
@set_option
@hide_option
@option(
    "--segments n_segments",
    "Parts of the session before each of which things are set up anew, for causes such as segment_zero.",
    click.IntRange(1, 10_000),
    default=1,
)
@seed_option
@option("--out", "Session to write (zarr).", OutputPath(), required=True)
@option("--csv csv_path", "Write the readings as CSV as well.", OutputPath())
@result_options
def simulate_command(
    rig_path: Path,
    plan_path: Path,
    truth: str,
    assignments: tuple[str, ...],
    hidden: tuple[str, ...],
    n_segments: int,
    seed: int,
    out: Path,
    csv_path: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Simulate a session whose true parameters are known."""
    from estimator.model.hide import full_names, hidden_shapes
    from estimator.model.simulate import idle_causes, simulate
    from estimator.readings.plan import load_plan
    from estimator.rig_files.read import load_rig
    from estimator.store.importers.readings_csv import write_readings_csv
    from estimator.store.session import SESSION, Session
    from estimator.store.staging import check_output

    check_output(out, overwrite, SESSION)
    if csv_path is not None:
        check_output(csv_path, overwrite)
    rig = load_rig(rig_path)
    values = truth_of(rig, truth, seed) | named_number(assignments, "--set")
    plan = load_plan(plan_path, rig)
    causes = full_names(rig, named_number(hidden, "--hide"))
    readings = simulate(rig, plan, values, seed, causes, n_segments)
    for idle in idle_causes(rig.with_values(values), readings, causes):
        click.echo(
            f"coilcal: warning: {idle} = {causes[idle]:g} changes no reading of this session", err=True
        )
    values |= causes | hidden_shapes(rig, readings, causes)
    session = Session(rig, readings, f"simulated with plan {plan.name!r}, seed {seed}", truth=values)
    if csv_path is not None:
        write_readings_csv(session, csv_path, overwrite)
    session.save(out, overwrite)
    from estimator.reporting.numbers import displays

    n_validation = int(readings.is_validation.sum())
    result = {"session": str(out), "readings": len(readings), "validation": n_validation, "truth": values}
    text = f"{len(readings)} readings ({n_validation} of them for validation) written to {out}; truth:\n"
    shown_as = displays(list(values))
    text += "\n".join(
        f"  {name} = {each.factor * values[name]:.6g} {each.unit}".rstrip() for name, each in shown_as.items()
    )
    show(result, text, as_json)


def truth_of(rig: Rig, choice: str, seed: int) -> dict[str, float]:
    """Parameter values that the option --truth asks for: `prior`, `nominal` or a JSON file.

    Raises:
        InvalidInput: It is none of these.
    """
    if choice == "prior":
        from estimator.model.simulate import draw_truth

        return draw_truth(rig, seed)
    if choice == "nominal":
        return {parameter.name: parameter.value for parameter in rig.free}
    rule = "--truth must be prior, nominal or a JSON file {parameter: number}"
    try:
        content = json_object(read_given(Path(choice), MOST_SETTINGS_BYTES), choice)
    except InvalidInput as fault:
        raise InvalidInput(f"{rule}; {fault}") from fault
    for name, value in content.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > LARGEST:
            words = f"--truth must give numbers between {-LARGEST:g} and {LARGEST:g}"
            raise InvalidInput(f"{words}; received {quoted(value)} for {quoted(name)} ({choice})")
    return {name: float(value) for name, value in content.items()}

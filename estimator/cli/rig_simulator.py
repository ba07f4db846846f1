"""`coilcal rig-simulator`: the instruments of a rig as processes behind real ports, for a rig without hardware."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from estimator.cli.named import named_number
from estimator.cli.options import (
    PATH,
    OutputPath,
    hide_option,
    option,
    overwrite_option,
    seed_option,
    set_option,
    truth_option,
)
from estimator.cli.output import CoilcalCommand


@click.command("rig-simulator", cls=CoilcalCommand)
@click.argument("rig_path", metavar="RIG", type=PATH)
@hide_option
@truth_option("nominal")
@set_option
@seed_option
@option(
    "--out", "File to write the devices section to, for the option --devices of other commands.", OutputPath()
)
@overwrite_option
def rig_simulator_command(
    rig_path: Path,
    hidden: tuple[str, ...],
    truth: str,
    assignments: tuple[str, ...],
    seed: int,
    out: Path | None,
    overwrite: bool,
) -> None:
    """Simulate the instruments of RIG until Ctrl-C.

    Each device gets a simulator; the command prints the devices section that opens them. All simulators share one world, whose field is
    that of the model. A rig without devices gets a Lake Shore F71 for each sensor, a Kepco BOP for each coil, an arm for each mover and a
    Lake Shore 224 that measures the coils' temperatures. Coils warm up by their losses.
    """
    import yaml

    from drivers.interlock import sigterm_as_exception
    from estimator.cli.simulate import truth_of
    from estimator.cli.simulated_devices import default_devices, start_simulators, watch
    from estimator.model.hide import full_names
    from estimator.model.simulated_field import simulated_rig
    from estimator.rig_files.devices import DEVICES
    from estimator.rig_files.read import load_rig
    from estimator.store.staging import check_output, write_output

    if out is not None:
        check_output(out, overwrite)
    rig = load_rig(rig_path)
    values = truth_of(rig, truth, seed) | named_number(assignments, "--set")
    true_rig = simulated_rig(rig, values, full_names(rig, named_number(hidden, "--hide")))
    section = rig.devices or default_devices(rig)
    with sigterm_as_exception(), start_simulators(section, rig, true_rig, seed) as simulators:
        text = yaml.safe_dump(
            {DEVICES: simulators.section}, sort_keys=False, default_flow_style=None, width=120
        )
        if out is not None:
            write_output(out, text, overwrite)
        click.echo(text)
        click.echo("coilcal: the rig runs; Ctrl-C ends it", err=True)
        sys.stdout.flush()
        try:
            watch(simulators)
        except KeyboardInterrupt:
            click.echo("coilcal: the rig has ended", err=True)

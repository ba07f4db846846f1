"""Entry point of the command `coilcal`.

Files of commands declare arguments and options, and import what a command needs when it runs: help, shell completion, `--version` and
refusals of arguments load neither torch nor any other large library.
"""

from __future__ import annotations

import click

from estimator.cli.acquire import acquire_command
from estimator.cli.batch import batch_command
from estimator.cli.bench import bench_command
from estimator.cli.calibrate import calibrate_command
from estimator.cli.check import check_command
from estimator.cli.compare import compare_command
from estimator.cli.design import design_command
from estimator.cli.devices import devices_group
from estimator.cli.diagnose import diagnose_command
from estimator.cli.docs import docs_command
from estimator.cli.explain import explain_command
from estimator.cli.export import export_command
from estimator.cli.import_readings import import_command
from estimator.cli.init import init_command
from estimator.cli.live import live_command
from estimator.cli.multipoles import multipoles_command
from estimator.cli.options import MOST_PROCESSES, option
from estimator.cli.output import CoilcalGroup
from estimator.cli.plan import plan_command
from estimator.cli.predict import predict_command
from estimator.cli.recalibrate import recalibrate_command
from estimator.cli.report import report_command
from estimator.cli.rig_simulator import rig_simulator_command
from estimator.cli.schema import schema_group
from estimator.cli.serve import serve_group
from estimator.cli.show import show_command
from estimator.cli.simulate import simulate_command


@click.group(cls=CoilcalGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="coilcal")
@option(
    "--threads",
    "Threads per tensor operation; a diagnosis uses several cores in another way.",
    click.IntRange(1, MOST_PROCESSES),
    default=1,
)
@option(
    "--via",
    "Where the command is carried out: local is a coilcal serve of yours on this computer, which has all libraries loaded. Without one, "
    "and where the result could differ, the command runs here.",
    click.Choice(["here", "local"]),
    default="here",
    envvar="COILCAL_VIA",
)
def main(threads: int, via: str) -> None:
    """Calibrate electromagnet coils from measured readings, with credible intervals.

    Exit codes: 0 done, 2 bad input, 3 damaged file, 4 sampling did not converge, 5 an instrument failed, 130 interrupted.

    Of calibrate also: 6 the result is unusable.

    Of recalibrate also: 10 a drift was found, 11 a session was rejected.
    """


for command in (
    init_command,
    check_command,
    plan_command,
    simulate_command,
    import_command,
    multipoles_command,
    calibrate_command,
    diagnose_command,
    compare_command,
    design_command,
    predict_command,
    export_command,
    report_command,
    show_command,
    explain_command,
    docs_command,
    schema_group,
    recalibrate_command,
    batch_command,
    devices_group,
    rig_simulator_command,
    acquire_command,
    live_command,
    serve_group,
    bench_command,
):
    main.add_command(command)

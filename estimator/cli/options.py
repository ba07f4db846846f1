"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

MOST_PROCESSES = (
    1024  # threads or workers; no computer has more processors, and a million threads end the program
)

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class OutputPath(click.Path):
    """A path that a command writes; `CoilcalCommand` keeps it away from what the command reads.

    Attributes:
        is_filled: Files are added to the folder, which may hold anything else; otherwise the whole path is made or replaced.
    """

    def __init__(self, is_filled: bool = False) -> None:
        super().__init__(path_type=Path)
        self.is_filled = is_filled


json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an existing output.")
seed_option = click.option(
    "--seed",
    type=click.IntRange(0, 2**32 - 1),
    default=0,
    show_default=True,
    help="Seed of the random numbers; the same seed repeats the same result.",
)
ess_option = click.option(
    "--ess",
    type=click.FloatRange(min=10),
    default=2000.0,
    show_default=True,
    help="Effective sample size that every parameter must reach.",
)
as_described_option = click.option(
    "--as-described",
    is_flag=True,
    help="Fit the rig as its file describes it, without the room's field and the zero of the sensors where it does not mention them.",
)
REFUSED_SINGLE = "; refused where single precision would be seen beside the noise"
other_rig_option = click.option(
    "--rig",
    "rig_path",
    type=click.Path(path_type=Path),
    help="Rig file to use instead of the rig stored in the session.",
)
devices_option = click.option(
    "--devices",
    "devices_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Take the devices from this file instead of the rig file; coilcal rig-simulator writes such files.",
)
hide_option = click.option(
    "--hide",
    "hidden",
    multiple=True,
    metavar="CAUSE=SIZE",
    help="Simulate a cause that the rig file does not describe, as CAUSE[PLACE].QUANTITY=SIZE in SI units. Leave PLACE or QUANTITY out "
    "where there is only one, or to take the first. Repeatable.",
)
set_option = click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="NAME=VALUE",
    help="Set one parameter of the truth, in SI units. Repeatable.",
)


def prediction_options(what: str, refused: str = "") -> Decorator:
    """Options for the device and the precision of predictions.

    Args:
        what: Is predicted.
        refused: When single precision is refused, to follow a semicolon.
    """
    device = click.option(
        "--device",
        default="cpu",
        show_default=True,
        metavar="NAME",
        help=f"Where {what} are predicted, such as cuda; reports stay on the processor.",
    )
    precision = click.option(
        "--precision",
        type=click.Choice(["double", "single"]),
        default="double",
        show_default=True,
        help=f"Of predicted {what}{refused}.",
    )
    return lambda command: device(precision(command))


def truth_option(default: str) -> Decorator:
    """Option for the true parameter values of a simulation."""
    return click.option(
        "--truth",
        default=default,
        show_default=True,
        help="True parameter values: 'prior' draws them from the rig's priors, 'nominal' takes the rig's values, anything else is a "
        "JSON file {parameter: SI value}.",
    )

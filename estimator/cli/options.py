"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

# Threads or workers: no computer has more processors, and a million threads end the program
MOST_PROCESSES = 1024

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
PATH = click.Path(path_type=Path)


def option(names: str, words: str, kind: Any = None, **more: Any) -> Decorator:
    """An option of a command.

    Args:
        names: Its flags, and the name of its argument where that is another, with blanks between: `--rig rig_path`.
        words: Its help.
        kind: Type of its value; text, or the type of the default.
        more: Further parameters of `click.option`. The help shows a default, unless `show_default` says otherwise.
    """
    return click.option(*names.split(), type=kind, help=words, **{"show_default": "default" in more, **more})


def flag(names: str, words: str, **more: Any) -> Decorator:
    """An option without a value; parameters as of `option`."""
    return option(names, words, is_flag=True, **more)


class OutputPath(click.Path):
    """A path that a command writes; `CoilcalCommand` keeps it away from what the command reads.

    Attributes:
        is_filled: Files are added to the folder, which may hold anything else; otherwise the whole path is made or replaced.
    """

    def __init__(self, is_filled: bool = False) -> None:
        super().__init__(path_type=Path)
        self.is_filled = is_filled


json_option = flag("--json as_json", "Print the result as one JSON object.")
overwrite_option = flag("--overwrite", "Replace an existing output.")


def result_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of a command that writes something and prints a result."""
    return overwrite_option(json_option(command))


seed_option = option(
    "--seed",
    "Seed of the random numbers; the same seed repeats the same result.",
    click.IntRange(0, 2**32 - 1),
    default=0,
)
ess_option = option(
    "--ess",
    "Effective sample size that every parameter must reach.",
    click.FloatRange(min=10),
    default=2000.0,
)
as_described_option = flag(
    "--as-described",
    "Fit the rig as its file describes it, without the room's field and the zero of the sensors where it does not mention them.",
)
REFUSED_SINGLE = "; refused where single precision would be seen beside the noise"
other_rig_option = option("--rig rig_path", "Rig file to use instead of the rig stored in the session.", PATH)
devices_option = option(
    "--devices devices_path",
    "Take the devices from this file instead of the rig file; coilcal rig-simulator writes such files.",
    PATH,
    metavar="FILE",
)
hide_option = option(
    "--hide hidden",
    "Simulate a cause that the rig file does not describe, as CAUSE[PLACE].QUANTITY=SIZE in SI units. Leave PLACE or QUANTITY out "
    "where there is only one, or to take the first. Repeatable.",
    multiple=True,
    metavar="CAUSE=SIZE",
)
set_option = option(
    "--set assignments",
    "Set one parameter of the truth, in SI units. Repeatable.",
    multiple=True,
    metavar="NAME=VALUE",
)


def prediction_options(what: str, refused: str = "") -> Decorator:
    """Options for the device and the precision of predictions.

    Args:
        what: Is predicted.
        refused: When single precision is refused, to follow a semicolon.
    """
    device = option(
        "--device",
        f"Where {what} are predicted, such as cuda; reports stay on the processor.",
        default="cpu",
        metavar="NAME",
    )
    precision = option(
        "--precision", f"Of predicted {what}{refused}.", click.Choice(["double", "single"]), default="double"
    )
    return lambda command: device(precision(command))


def truth_option(default: str) -> Decorator:
    """Option for the true parameter values of a simulation."""
    return option(
        "--truth",
        "True parameter values: 'prior' draws them from the rig's priors, 'nominal' takes the rig's values, anything else is a "
        "JSON file {parameter: SI value}.",
        click.Path(),
        default=default,
        metavar="TEXT",
    )

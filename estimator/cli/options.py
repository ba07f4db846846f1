"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
seed_option = click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
ess_option = click.option(
    "--ess",
    type=click.FloatRange(min=10),
    default=2000.0,
    show_default=True,
    help="Effective samples of every parameter.",
)
other_rig_option = click.option(
    "--rig", "rig_path", type=click.Path(path_type=Path), help="Another description of the session's rig."
)
hide_option = click.option(
    "--hide",
    "hidden",
    multiple=True,
    metavar="CAUSE=SIZE",
    help="Hide a cause that the rig file does not tell of, as CAUSE[PLACE].QUANTITY=SIZE in SI; place and quantity may be left out "
    "where there is one, or the first is meant. Repeatable.",
)
set_option = click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="NAME=VALUE",
    help="Set one parameter of the truth, in SI; repeatable.",
)


def truth_option(default: str) -> Decorator:
    """Where the truth of a simulation comes from."""
    return click.option(
        "--truth",
        default=default,
        show_default=True,
        help="'prior' draws the truth from the rig's priors, 'nominal' takes its values, else a JSON file {parameter: SI value}.",
    )

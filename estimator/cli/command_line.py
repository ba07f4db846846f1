"""The running command as a line that repeats it, for the provenance of what it writes."""

from __future__ import annotations

import shlex
from typing import Any

import click
from click.core import ParameterSource

# They say how something is told, replaced or shared out, not what is computed.
NOT_OF_THE_RESULT = frozenset({"as_json", "overwrite", "workers", "scheduler"})
ALWAYS = frozenset({"seed"})


def command_of(context: click.Context) -> str:
    """The command that a context runs, with all that was given to it and its seed; quoted for a shell.

    Args:
        context: Of the running command, such as `click.get_current_context()`.

    Examples:
        >>> @click.command("predict")
        ... @click.argument("folder")
        ... @click.option("--seed", default=0)
        ... def predict(folder, seed):
        ...     click.echo(command_of(click.get_current_context()))
        >>> click.Group(commands=[predict]).main(["predict", "my coil"], standalone_mode=False)
        coilcal predict 'my coil' --seed 0
    """
    arguments, options = list[str](), list[str]()
    for parameter in context.command.params:
        name = str(parameter.name)
        if name not in context.params or name in NOT_OF_THE_RESULT:
            continue
        is_default = context.get_parameter_source(name) in (
            ParameterSource.DEFAULT,
            ParameterSource.DEFAULT_MAP,
        )
        value = context.params[name]
        if value is None or (is_default and name not in ALWAYS):
            continue
        (arguments if isinstance(parameter, click.Argument) else options).extend(_words(parameter, value))
    return shlex.join(["coilcal", *_subcommands(context), *arguments, *options])


def _subcommands(context: click.Context) -> list[str]:
    """Names of the commands below `coilcal`, such as `devices check`."""
    above = [] if context.parent is None else _subcommands(context.parent)
    return above if context.parent is None else [*above, str(context.info_name)]


def _words(parameter: click.Parameter, value: Any) -> list[str]:
    """Words that give a parameter its value."""
    if isinstance(parameter, click.Argument):
        return [_word(each) for each in (value if parameter.nargs != 1 else [value])]
    assert isinstance(parameter, click.Option)
    if parameter.is_flag:
        return [parameter.opts[0] if value or not parameter.secondary_opts else parameter.secondary_opts[0]]
    repeated = value if parameter.multiple else [value]
    words = list[str]()
    for each in repeated:
        words += [parameter.opts[0], *(map(_word, each) if parameter.nargs != 1 else [_word(each)])]
    return words


def _word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)

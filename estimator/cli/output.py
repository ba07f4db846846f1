"""What every command shares: threads, faults in one sentence with an exit code, results as text or JSON.

This file and `options` are loaded for every page of help, so they import nothing heavy.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import click
from click.core import ParameterSource

from drivers.errors import DriverError, Refused
from estimator.cli.interruption import ignore_interruptions, interrupt_once
from estimator.cli.options import OutputPath
from estimator.cli.without_torch import on_numpy
from estimator.errors import CoilcalError, CorruptStore, InvalidInput, cut, quoted, reason
from estimator.store.files import real, unwritable
from estimator.units import LARGEST

EXIT_BAD_INPUT, EXIT_CORRUPT, EXIT_NOT_CONVERGED, EXIT_DEVICE = 2, 3, 4, 5
EXIT_UNUSABLE, EXIT_UNDELIVERED = 6, 7
EXIT_INTERRUPTED = 130
EXIT_DRIFTED, EXIT_REJECTED = 10, 11
LONG_WORD = re.compile(r"\S{200,}")
PARTS = frozenset(  # of calibrations and diagnoses, which are read as a whole
    {
        "summary.json",
        "posterior.zarr",
        "chain.zarr",
        "diagnosis.json",
        "rig_extended.yaml",
        "fits.jsonl",
        "calibration",
    }
)
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")


# Keys of what a call shares between its parts.
QUIET = "coilcal.is_quiet"


def is_quiet() -> bool:
    """Whether the command that runs was called with `--quiet`."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(QUIET))


def tell_progress(line: str) -> None:
    """Tell on standard error how far the command is, unless it is to be quiet."""
    if not is_quiet():
        click.echo(line, err=True)


def _keep_quiet(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    ctx.meta[QUIET] = value


def _log(_: click.Context, __: click.Parameter, value: bool) -> None:
    if value:
        logging.basicConfig(format="%(asctime)s %(name)s: %(message)s")  # to standard error
        for package in ("estimator", "drivers"):
            logging.getLogger(package).setLevel(logging.DEBUG)


class ShortMessages(click.Command):
    """A command that quotes at most the beginning of a wrong argument."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """See `click.Command.parse_args`."""
        with _shortened():
            return super().parse_args(ctx, args)


class CoilcalGroup(ShortMessages, click.Group):
    """A group of commands that quotes at most the beginning of a wrong argument; Ctrl-C interrupts it once."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the program."""
        interrupt_once()
        try:
            return super().main(*args, **kwargs)
        finally:
            ignore_interruptions()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """See `click.Command.parse_args`."""
        ctx.meta.setdefault("coilcal.given", list(args))  # those of the program come first
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """See `click.Group.resolve_command`."""
        with _shortened():
            return super().resolve_command(ctx, args)


@contextmanager
def _shortened() -> Iterator[None]:
    try:
        yield
    except click.UsageError as error:
        message = error.format_message()
        if not LONG_WORD.search(message):
            raise
        raise click.UsageError(LONG_WORD.sub(lambda found: cut(found[0]), message), error.ctx) from error


class CoilcalCommand(ShortMessages):
    """A command that uses the threads of `--threads`, has `--quiet` and `--verbose`, and explains its faults.

    Attributes:
        goes_on: After an interruption, the same command goes on where it was.
        takes_derivatives: It needs torch; others compute on NumPy.
    """

    def __init__(
        self, *args: Any, goes_on: bool = False, takes_derivatives: bool = True, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.goes_on, self.takes_derivatives = goes_on, takes_derivatives
        words = {
            "quiet": ("No progress on standard error; faults and warnings stay.", _keep_quiet),
            "verbose": ("Log on standard error what modules do.", _log),
        }
        for name, (help_text, callback) in words.items():
            option = click.Option(
                [f"--{name}"], is_flag=True, expose_value=False, help=help_text, callback=callback
            )
            self.params.append(option)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; help, completion and refused arguments never get here, so they do not load torch."""
        with explained_errors(as_json=bool(ctx.params.get("as_json")), goes_on=self.goes_on):
            if ctx.find_root().params.get("via") == "local":
                from estimator.cli.local import carry_out

                carry_out(ctx, self.takes_derivatives)
            use_threads(ctx.find_root().params.get("threads", 1))
            keep_apart(ctx)
            for option in self.params:
                if ctx.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE:
                    _check_size(option, ctx.params.get(option.name or ""))
            if self.takes_derivatives:
                return super().invoke(ctx)
            with on_numpy(ctx.params):
                return super().invoke(ctx)


def _check_size(option: click.Parameter, value: object) -> None:
    """Refuse an option that is no number, or beyond what any calculation takes: NaN passes through a range, and infinity has no upper end.

    Raises:
        InvalidInput: The value is NaN, infinite or too large.
    """
    for each in value if isinstance(value, tuple) else (value,):
        if isinstance(each, int | float) and not abs(each) <= LARGEST and each != option.default:
            rule = f"{option.opts[0]} must be a number between {-LARGEST:g} and {LARGEST:g}"
            raise InvalidInput(f"{rule}; received {quoted(each)}")


def keep_apart(ctx: click.Context) -> None:
    """Refuse a call that would write over what it reads, or two outputs over each other.

    Raises:
        InvalidInput: An output is an input, a part of one, or a folder that would be replaced with an input in it.
    """
    outputs: list[tuple[Path, OutputPath]] = []
    inputs: list[Path] = []
    for parameter in ctx.command.params:
        value = ctx.params.get(parameter.name or "")
        for given in value if isinstance(value, tuple) else (value,):
            if isinstance(parameter.type, OutputPath) and given is not None:
                outputs.append((given, parameter.type))
            elif isinstance(parameter.type, click.Path) and given is not None and os.path.lexists(given):
                inputs.append(Path(given))
    for n, (output, kind) in enumerate(outputs):
        for other, _ in outputs[:n]:
            if _is_within(output, other) or _is_within(other, output):
                raise InvalidInput(f"outputs must not be inside each other; received {other} and {output}")
        for given in inputs:
            if real(output) == real(given):
                raise InvalidInput(
                    f"output must be another path than what is read; received {output} for both"
                )
            if not kind.is_filled and _is_within(given, output):
                raise InvalidInput(f"output must not hold what is read; {output} holds {given}: take another")
            if _is_within(output, given) and output.name in PARTS and output.exists():
                raise InvalidInput(
                    f"output must not replace a part of what is read; {output} is a part of {given}"
                )


def _is_within(path: Path, folder: Path) -> bool:
    return real(path).is_relative_to(real(folder))


def use_threads(n_threads: int) -> None:
    """Set the threads of one tensor operation, here and in the processes that this one starts.

    torch reads the variable when it is loaded, which commands that compute nothing never do.
    """
    os.environ["OMP_NUM_THREADS"] = str(n_threads)
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(n_threads)


@contextmanager
def explained_errors(as_json: bool = False, goes_on: bool = False) -> Iterator[None]:
    """Turn faults that coilcal can explain into one sentence on standard error and an exit code, and into JSON where that was asked for."""
    try:
        yield
    except CoilcalError as error:
        _end(str(error), EXIT_CORRUPT if isinstance(error, CorruptStore) else EXIT_BAD_INPUT, as_json)
    except DriverError as error:
        _end(str(error), EXIT_BAD_INPUT if isinstance(error, Refused) else EXIT_DEVICE, as_json)
    except (KeyboardInterrupt, click.Abort):
        _end("interrupted; the same command goes on" if goes_on else "interrupted", EXIT_INTERRUPTED, as_json)
    except BrokenPipeError:
        raise
    except OSError as error:  # the system refused a path before coilcal checked it
        _end(system_words(error), EXIT_BAD_INPUT, as_json)


def system_words(error: OSError) -> str:
    """A refusal of the system, in a sentence.

    Examples:
        >>> system_words(PermissionError(13, "Permission denied", "rig.yaml"))
        'rig.yaml must be readable and writable: Permission denied'
        >>> system_words(OSError(28, "No space left on device"))
        'the system must allow what coilcal asks of it; it refused with: No space left on device'
    """
    if error.filename is None:
        return f"the system must allow what coilcal asks of it; it refused with: {reason(error)}"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return str(unwritable(str(error.filename), error))
    return f"{error.filename} must be readable and writable: {reason(error)}"


def _end(sentence: str, exit_code: int, as_json: bool) -> NoReturn:
    """End with a fault."""
    click.echo(f"coilcal: {printable(sentence)}", err=True)
    if as_json:
        click.echo(json.dumps({"error": sentence, "exit_code": exit_code}, indent=2))
    sys.exit(exit_code)


def printable(text: str) -> str:
    """A line that may hold what stands in a file, without the characters that would steer the terminal."""
    return CONTROL.sub(lambda found: repr(found[0])[1:-1], text)


@contextmanager
def needing(extra: str, what: str) -> Iterator[None]:
    """Say which extra is missing if an import in the block fails; `what` needs it."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise InvalidInput(
            f"{what} needs {error.name}: install coilcal with its extra, pip install 'coilcal[{extra}]'"
        ) from error


def show(result: Mapping[str, Any], text: str, as_json: bool) -> None:
    """Print a result for people or for programs."""
    try:
        click.echo(json.dumps(result, indent=2, allow_nan=False) if as_json else text)
    except BrokenPipeError:
        raise
    except OSError as error:
        sys.stdout = None  # or Python fails to flush it once more at its end
        raise unwritable("standard output", error) from error

"""What every command shares: results as text or JSON, progress on a terminal or in a pipe, errors in one sentence."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from drivers.errors import DriverError, Refused
from estimator.calibration.calibrate import Stage
from estimator.errors import CoilcalError, CorruptStore, InvalidInput, reason

EXIT_BAD_INPUT, EXIT_CORRUPT, EXIT_NOT_CONVERGED, EXIT_DEVICE = 2, 3, 4, 5
EXIT_DRIFTED, EXIT_REJECTED = 10, 11

P = ParamSpec("P")
R = TypeVar("R")


def explain_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Turn faults that coilcal can explain into one sentence and an exit code."""

    @wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except CoilcalError as error:
            click.echo(f"coilcal: {error}", err=True)
            sys.exit(EXIT_CORRUPT if isinstance(error, CorruptStore) else EXIT_BAD_INPUT)
        except DriverError as error:
            click.echo(f"coilcal: {error}", err=True)
            sys.exit(EXIT_BAD_INPUT if isinstance(error, Refused) else EXIT_DEVICE)
        except BrokenPipeError:
            raise
        except OSError as error:  # a path that the system refuses before coilcal looks at it
            click.echo(f"coilcal: {error.filename} must be readable and writable: {reason(error)}", err=True)
            sys.exit(EXIT_BAD_INPUT)

    return wrapped


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Keep a file that nobody asked to replace.

    Raises:
        InvalidInput: It exists.
    """
    if path.exists() and not overwrite:
        raise InvalidInput(f"output must not exist yet, or be replaced with --overwrite; received {path}")


def named_numbers(text: str, option: str, count: int) -> tuple[str, list[float]]:
    """An option such as coil1=3 or arm1=0,0,0.1,0,0,0: a name and finite numbers.

    Raises:
        InvalidInput: It looks otherwise.
    """
    name, _, values = text.partition("=")
    try:
        numbers = [float(value) for value in values.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise InvalidInput(f"{option} must look like NAME={','.join(['1.0'] * count)}; received {text!r}")
    return name, numbers


def named_number(texts: Sequence[str], option: str) -> dict[str, float]:
    """Options such as coil1=3 by name.

    Raises:
        InvalidInput: One looks otherwise, or a name comes twice.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, (value,) = named_numbers(text, option, 1)
        if name in found:
            raise InvalidInput(f"{option} must name {name} once; received it again in {text!r}")
        found[name] = value
    return found


def show(result: Mapping[str, Any], text: str, as_json: bool) -> None:
    """Print a result for people or for programs."""
    click.echo(json.dumps(result, indent=2, allow_nan=False) if as_json else text)


class StageReporter:
    """Shows the stages of a calibration: a bar on a terminal, plain lines in a pipe; always on standard error."""

    def __init__(self) -> None:
        self._last = ""
        console = Console(stderr=True)
        self._bar: Progress | None = None
        # Console.is_terminal also believes FORCE_COLOR, which build servers set while they record a pipe.
        if sys.stderr.isatty():
            columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
            self._bar = Progress(*columns, console=console, transient=True)
            self._task = self._bar.add_task("starting", total=None)

    def __enter__(self) -> StageReporter:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, stage: Stage) -> None:
        """Show one stage."""
        lines = [] if stage.name == self._last else [stage.name]
        self._last = stage.name
        lines += [f"  not determined by the data: {direction.words}" for direction in stage.open_directions]
        sampling = stage.sampling
        detail = ""
        if sampling is not None:
            detail = f"step {sampling.step}, effective samples {sampling.smallest_ess:.0f} of {sampling.target_ess:.0f}"
            detail += f", R-hat {sampling.largest_rhat:.4f}"
        if self._bar is None:
            for line in (*lines, *([f"  {detail}"] if detail else [])):
                click.echo(line, err=True)
            return
        for line in lines:
            self._bar.console.print(line)
        if sampling is not None:
            self._bar.update(
                self._task,
                description=detail,
                total=sampling.target_ess,
                completed=min(sampling.smallest_ess, sampling.target_ess),
            )
        else:
            self._bar.update(self._task, description=stage.name, total=None)

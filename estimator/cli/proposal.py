"""What was understood of a file that is no readings CSV, as a table with three rows in SI; asked once, and written as a recipe."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from estimator.cli.output import is_quiet, printable
from estimator.errors import InvalidInput, cut
from estimator.glance import aligned
from estimator.store.files import write_text
from estimator.store.importers.forms.preview import PreviewedColumn, first_lines_of, previewed_column
from estimator.store.importers.forms.recipe import CLOCK, DATE
from estimator.store.importers.forms.understand import Proposal, Understood

RECIPE = "columns.yaml"
LONGEST_HEADER = 28  # characters of a heading in the table


def proposal_lines(path: Path, read: Understood) -> list[str]:
    """A proposal in lines.

    Args:
        path: The file.
        read: What was read of it.
    """
    proposal = read.proposal
    assert proposal is not None
    head = ["column", "is", *(f"line {line}" for line in first_lines_of(read.table))]
    rows = [head] + [_row(previewed_column(each, read)) for each in proposal.assigned]
    lines = [f"{path}: {len(read.readings.observations)} readings. {' '.join(proposal.remarks)}"]
    lines += [f"  {line}" for line in aligned(rows)]
    return [printable(line) for line in lines]


def _row(column: PreviewedColumn) -> list[str]:
    """Heading, meaning, and the first rows in SI."""
    meaning = {CLOCK: "time of day", DATE: "date"}.get(column.name, column.name)
    return [cut(column.header, LONGEST_HEADER), meaning, *column.values]


def settle(path: Path, read: Understood, is_accepted: bool, is_asked: bool) -> None:
    """Show a proposal, and ask once whether it is right.

    Args:
        path: The file.
        read: What was read of it.
        is_accepted: Whether `--yes` or a recipe accepts it.
        is_asked: Whether a question may be asked.
    Raises:
        InvalidInput: It is not accepted.
    """
    if not (is_accepted and is_quiet()):
        for line in proposal_lines(path, read):
            click.echo(line, err=True)
    if is_accepted:
        return
    if is_asked and is_terminal():
        if click.confirm("Import it so?", err=True):
            return
        raise InvalidInput(
            f"columns must be right; say what they are with --column 'HEADER=NAME' for each that is not ({path})"
        )
    raise InvalidInput(
        f"{path} is no readings CSV, so what was understood of it must be accepted: add --yes if the table above is right, "
        f"else say what a column is with --column 'HEADER=NAME'"
    )


def is_terminal() -> bool:
    """Whether the question can be shown and answered."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def write_recipe(proposal: Proposal, out: Path) -> Path:
    """Write the recipe beside an output; another one that is there stays.

    Returns: The file.
    """
    path, text = out.parent / RECIPE, proposal.recipe.text()
    if path.exists() and path.read_text(encoding="utf-8", errors="replace") != text:
        path = out.parent / f"{out.stem}.{RECIPE}"
    write_text(path, text)
    return path

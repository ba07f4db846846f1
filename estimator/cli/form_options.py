"""Options that say how a file of readings is read, for the commands that read one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.options import PATH, flag, option
from estimator.errors import check_known

if TYPE_CHECKING:
    from estimator.rig.rig import Rig
    from estimator.store.importers.forms.recipe import Recipe

CLOCKS = ("as-written", "continue", "spread", "rows")
OPTIONS = (
    option(
        "--map map_path",
        "How the columns are read, as an earlier import has written it (columns.yaml).",
        PATH,
        metavar="FILE",
    ),
    option(
        "--column columns",
        "What a column of the file is, as 'Probe 1=Bx_mT'; 'HEADER=-' leaves it out. Repeatable.",
        multiple=True,
        metavar="HEADER=NAME",
    ),
    option(
        "--constant constants",
        "The value of a column that the file does not have, in all rows, as arm1_x_mm=0. Repeatable.",
        multiple=True,
        metavar="NAME=VALUE",
    ),
    option("--decimal", "Decimal sign, where the file does not tell.", click.Choice(["point", "comma"])),
    option("--sheet", "Sheet of a workbook; the first with a table where left out.", metavar="NAME"),
    option(
        "--clock",
        "How times are read: 'continue' goes on behind a clock that was set back, 'spread' shares out the readings of one stamp "
        "evenly up to the next, 'rows' counts rows.",
        click.Choice(CLOCKS),
        default="as-written",
    ),
    flag(
        "--skip-bad-lines skips_bad",
        "Leave out lines that are no rows, and rows with a cell that cannot be read; says which.",
    ),
)


@dataclass(frozen=True)
class FormOptions:
    """Values of the options; see `OPTIONS`."""

    map_path: Path | None
    columns: tuple[str, ...]
    constants: tuple[str, ...]
    decimal: str | None
    sheet: str | None
    clock: str
    skips_bad: bool

    def with_currents(self, rig: Rig, currents_A: Mapping[str, float]) -> Recipe:
        """The recipe that they make, with currents by coil.

        Raises:
            InvalidInput: An option has another form, names no coil, or the file with the recipe is wrong.
        """
        from estimator.readings.clock import Clock
        from estimator.store.importers.forms.recipe import Recipe, named_columns, named_constants, read_recipe

        recipe = Recipe() if self.map_path is None else read_recipe(self.map_path)
        coils = [coil.name for coil in rig.coils]
        check_known("--current must name coils", currents_A, coils)
        constants = named_constants(self.constants) | {
            f"{name}_current_A": value for name, value in currents_A.items()
        }
        return replace(
            recipe,
            columns={**recipe.columns, **named_columns(self.columns)},
            constants={**recipe.constants, **constants},
            decimal=self.decimal or recipe.decimal,
            sheet=self.sheet or recipe.sheet,
            clock=Clock(self.clock) if self.clock != CLOCKS[0] else recipe.clock,
            skips_bad=self.skips_bad or recipe.skips_bad,
        )


def form_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command these options, as one argument `form`."""

    @wraps(command)
    def with_form(**given: Any) -> Any:
        form = FormOptions(**{each.name: given.pop(each.name) for each in fields(FormOptions)})
        return command(form=form, **given)

    decorated: Callable[..., Any] = with_form
    for add in reversed(OPTIONS):
        decorated = add(decorated)
    return decorated

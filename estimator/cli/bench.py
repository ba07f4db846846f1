"""`coilcal bench`: how fast coilcal is on this machine, beside other programs in the same run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.options import flag, json_option, option, seed_option
from estimator.cli.output import CoilcalCommand, show, tell_progress
from estimator.errors import check_known

if TYPE_CHECKING:
    from estimator.benchmarks.rows import Row

PARTS = {
    "fields": "field of a winding of 48 x 25 loops",
    "derivatives": "field and its derivatives by position, the same winding",
    "estimate": "point estimate",
    "sampling": "sampling, the slowest of 10 parameters",
    "diagnosis": "diagnosis",
    "live": "live",
}


@click.command("bench", cls=CoilcalCommand)
@option("--only", f"Measure these parts only, of {', '.join(PARTS)}.", metavar="PART,...")
@option(
    "--repeats",
    "Repeats, of which median, smallest and largest are printed.",
    click.IntRange(1, 10_000),
    default=5,
)
@flag("--tiny", "Small sizes, to see that all works; their timings mean nothing.")
@seed_option
@json_option
def bench_command(only: str | None, repeats: int, tiny: bool, seed: int, as_json: bool) -> None:
    """Print how fast coilcal is here, beside magpylib and plain emcee in the same run.

    Seconds are those of the clock. It takes about two minutes where nothing else runs; compare ratios where something does.
    """
    import torch

    from estimator.benchmarks.machine import is_busy, machine

    chosen = parts_of(only)
    here = {**machine(), "threads": torch.get_num_threads()}
    result: dict[str, Any] = {
        "machine": here,
        "repeats": repeats,
        "seed": seed,
        "is_tiny": tiny,
        "warnings": [],
        "parts": {},
    }
    if is_busy(here["load"], here["cores"]):
        result["warnings"].append(
            f"the load of {here['load']:.1f} is above half of the {here['cores']} cores, so times are too long; compare ratios only"
        )
    if here["magpylib"] is None and {"fields", "derivatives"} & set(chosen):
        result["warnings"].append(
            "magpylib is not installed, so fields have no peer; pip install magpylib adds it"
        )
    lines = [
        ", ".join(f"{key} {_number(value)}" for key, value in here.items() if value is not None),
        f"seed {seed}, {repeats} repeats: median (smallest to largest)",
    ]
    for warning in result["warnings"]:
        click.echo(f"coilcal: warning: {warning}", err=True)
    measures = _measures(tiny, repeats, seed)
    for part in chosen:
        tell_progress(f"measuring {part}")
        rows = measures[part]()
        result["parts"][part] = [row.to_json() for row in rows]
        lines += ["", PARTS[part], *map(line_of, rows)]
    show(result, "\n".join(lines), as_json)


def parts_of(only: str | None) -> list[str]:
    """The parts that `--only` names, in the order of the output.

    Raises:
        InvalidInput: There is no such part.
    """
    named = list(PARTS) if only is None else [name.strip() for name in only.split(",")]
    check_known("--only must name parts", named, PARTS)
    return [part for part in PARTS if part in named]


def line_of(row: Row) -> str:
    """A row as it is printed."""
    spread = f"{_number(row.median)} ({_number(min(row.values))} to {_number(max(row.values))}) {row.unit}"
    ratio = "" if row.ratio is None else f", {_number(row.ratio)} x"
    rhat = row.extra.get("largest_rhat", 1.0)
    guess = f", a guess: R-hat is {rhat:.2f}" if rhat > 1.01 else ""
    return f"  {row.name}: {spread}{ratio}{guess}"


def _measures(tiny: bool, repeats: int, seed: int) -> dict[str, Callable[[], list[Row]]]:
    from estimator.benchmarks.fields import derivative_rows, field_rows
    from estimator.benchmarks.sampling import estimate_rows, sampling_rows
    from estimator.benchmarks.sessions import diagnosis_rows, live_rows

    points = 20 if tiny else 1000
    side, target_ess, stretch_steps = (3, 200.0, 60) if tiny else (5, 4000.0, 3000)
    diagnosed, timed = (3, 3) if tiny else (8, 30)
    return {
        "fields": lambda: field_rows(points, repeats, seed),
        "derivatives": lambda: derivative_rows(points, repeats, seed),
        "estimate": lambda: estimate_rows(side, repeats, seed),
        "sampling": lambda: sampling_rows(side, target_ess, stretch_steps, repeats, seed),
        "diagnosis": lambda: diagnosis_rows(diagnosed, repeats, seed),
        "live": lambda: live_rows(diagnosed, timed, repeats, seed),
    }


def _number(value: Any) -> str:
    """Three digits, without powers of ten."""
    if not isinstance(value, float):
        return str(value)
    return f"{value:,.3g}" if value < 100 else f"{value:,.0f}"

"""The command in a report repeats what made it."""

from __future__ import annotations

import shlex

import click
import pytest

from estimator.cli.command_line import command_of
from estimator.cli.main import main

CALLS = [
    "calibrate session.zarr --out c",
    "calibrate 'my session.zarr' --out 'a b' --rig rig.yaml --seed 7 --ess 400 --walkers 20 --max-steps 90 --counts continuous --device cuda "
    "--precision single",
    "diagnose session.zarr --out d --rig rig.yaml --validation other.zarr --minutes 2.5 --most-causes 3 --thin 100 --no-posterior --seed 3",
    "diagnose session.zarr --out d --posterior",
    "diagnose session.zarr --out d --no-corrections",
    "compare session.zarr --map map.csv --map-current -0.1234567890123 --coil coil1 --out x",
    "batch a.zarr 'b c.zarr' --out o --hypothesis plain --hypothesis 'axis_gain+sensor_offset[probe2]' --each-coil --posterior none",
    "report folder",
]


def context_of(words: list[str]) -> click.Context:
    above = click.Context(main, info_name="anything")
    command = main.get_command(above, words[0])
    assert command is not None
    return command.make_context(words[0], words[1:], parent=above)


@pytest.mark.parametrize("call", CALLS)
def test_the_command_has_every_parameter_that_was_given(call):
    context = context_of(shlex.split(call))
    repeated = command_of(context)
    assert repeated.startswith("coilcal ")
    assert context_of(shlex.split(repeated)[1:]).params == context.params


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("calibrate s --out c --json --overwrite", "coilcal calibrate s --out c --seed 0"),
        ("batch s --out c --workers 3", "coilcal batch s --out c --seed 0"),
        ("diagnose s --out d --no-posterior", "coilcal diagnose s --out d --no-posterior --seed 0"),
    ],
)
def test_it_names_the_seed_and_leaves_out_what_changes_no_result(call, expected):
    assert command_of(context_of(shlex.split(call))) == expected

"""`coilcal bench` at small sizes: every part is there, beside its peer, with its range; timings are not judged."""

from __future__ import annotations

import json
import os
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.benchmarks import fields, machine
from estimator.benchmarks.rows import Row, by_turns, timed, with_ratios
from estimator.benchmarks.sessions import RIG
from estimator.cli.bench import PARTS, line_of
from tests.estimator.cli.conftest import run

CONFIGS = Path(__file__).parents[3] / "configs"
needs_magpylib = pytest.mark.skipif(find_spec("magpylib") is None, reason="magpylib is not installed")


@pytest.mark.slow  # `test_only_takes_some_parts_in_words` runs two
@pytest.mark.whole
def test_every_part_has_rows_beside_their_peers() -> None:
    printed = run("bench", "--tiny", "--repeats", 1, "--seed", 150000, "--json")
    assert printed.exit_code == 0
    result = json.loads(printed.stdout)
    assert set(result) == {"machine", "repeats", "seed", "is_tiny", "warnings", "parts"}
    assert {"processor", "cores", "threads", "load", "python", "coilcal", "torch"} <= set(result["machine"])
    assert list(result["parts"]) == list(PARTS)
    for rows in result["parts"].values():
        for row in rows:
            assert 0.0 < row["smallest"] == row["median"] == row["largest"]
    sampling = {row["name"]: row for row in result["parts"]["sampling"]}
    assert len(sampling) == 3
    plain = sampling["emcee's stretch move, real loop counts"]
    for row in sampling.values():
        assert row["ratio"] == pytest.approx(row["median"] / plain["median"])
        assert row["largest_rhat"] >= 0.99
    assert len(result["parts"]["diagnosis"]) == 2


def test_only_takes_some_parts_in_words() -> None:
    printed = run("bench", "--tiny", "--repeats", 3, "--only", "live,fields")
    assert printed.exit_code == 0
    lines = printed.stdout.splitlines()
    assert lines[0].startswith("processor ")
    assert "threads 1" in lines[0]
    assert lines[1] == "seed 0, 3 repeats: median (smallest to largest)"
    assert [line for line in lines if line in PARTS.values()] == [PARTS["fields"], PARTS["live"]]
    assert "measuring live" in printed.stderr


def test_repeats_are_printed_with_median_and_range() -> None:
    printed = run("bench", "--tiny", "--repeats", 3, "--only", "fields", "--json")
    for row in json.loads(printed.stdout)["parts"]["fields"]:
        assert len(row["values"]) == 3
        assert [row["smallest"], row["median"], row["largest"]] == sorted(row["values"])


def test_an_unknown_part_is_refused_in_one_sentence() -> None:
    printed = run("bench", "--only", "fields,filds")
    assert (printed.exit_code, printed.stdout) == (2, "")
    assert (
        printed.stderr
        == f"coilcal: --only must name parts ({', '.join(PARTS)}); received 'filds'; the closest is fields\n"
    )
    assert run("bench", "--repeats", 0).exit_code == 2


def test_without_magpylib_fields_have_no_peer_and_the_command_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fields, "has_magpylib", lambda: False)
    monkeypatch.setattr(machine, "_version", lambda name: None if name == "magpylib" else "1")
    printed = run("bench", "--tiny", "--repeats", 1, "--only", "fields,derivatives", "--json")
    result = json.loads(printed.stdout)
    assert any("magpylib is not installed" in warning for warning in result["warnings"])
    rows = [row for part in result["parts"].values() for row in part]
    assert rows
    assert all(row["ratio"] is None and row["name"].startswith("coilcal") for row in rows)


def test_a_load_above_half_of_the_cores_is_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "usable_cores", lambda: 4)
    for load, is_warned in ((1.9, False), (2.1, True)):
        monkeypatch.setattr(os, "getloadavg", lambda load=load: (load, 0.0, 0.0))
        printed = run("bench", "--tiny", "--repeats", 1, "--only", "fields")
        assert ("above half of the 4 cores" in printed.stderr) == is_warned


@needs_magpylib
def test_what_is_compared_is_the_same_field_and_the_same_derivatives() -> None:
    points_m, winding = fields.points_of(20, seed=1), fields.winding_of()
    rule = fields.exact_rule(winding, torch.from_numpy(points_m))
    peer = fields.over_loops(fields.magpylib_loops, *fields.loops_of_paper(fields.N_AXIAL, fields.N_RADIAL))
    ours = fields.by_rule(winding, rule)(points_m)
    np.testing.assert_allclose(ours, peer(points_m), rtol=0, atol=1e-10 * np.abs(ours).max())
    slopes = fields.gradient(points_m, winding, rule)
    # Central differences: step^2 / 6 times the third derivative, over a centimetre, is 1e-6 of the slopes.
    np.testing.assert_allclose(
        slopes, fields.differences(peer, points_m), rtol=0, atol=1e-5 * np.abs(slopes).max()
    )


def test_the_rig_of_the_wheel_is_that_of_the_checkout() -> None:
    assert RIG.read_bytes() == (CONFIGS / "paper_simulation.yaml").read_bytes()


def test_calls_take_turns_and_the_first_turn_does_not_count() -> None:
    order: list[str] = []
    seconds = by_turns({name: lambda name=name: order.append(name) for name in "ab"}, repeats=2)
    assert order == ["a", "b", "a", "b", "a", "b"]
    assert [len(values) for values in seconds.values()] == [2, 2]


def test_short_calls_are_repeated_and_their_mean_counts() -> None:
    calls: list[None] = []
    taken_s = timed(lambda: calls.append(time.sleep(0.001)), least_s=0.02)
    assert 1 < len(calls) <= 20
    assert taken_s * len(calls) >= 0.02


def test_a_line_has_median_range_and_ratio() -> None:
    row, _ = with_ratios([Row("ours", "s", (3.0, 1.0, 8.0)), Row("peer", "s", (1.5,))], "peer")
    assert line_of(row) == "  ours: 3 (1 to 8) s, 2 x"
    assert line_of(Row("x", "1/s", (1234.0,), extra={"largest_rhat": 1.5})).endswith("a guess: R-hat is 1.50")

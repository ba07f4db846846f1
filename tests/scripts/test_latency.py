"""A small run of the benchmark of latency: all ways are there, and the compiled header returns what Python does."""

from __future__ import annotations

import argparse
import shutil

import pytest

from scripts.benchmarks.latency import latency, show_latency


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_a_small_run_times_every_way(capsys):
    result = latency(argparse.Namespace(seed=5, tiny=True, repeats=1))
    assert len(result["rows"]) == 4
    assert all(
        smallest <= median <= largest
        for row in result["rows"].values()
        for median, smallest, largest in row.values()
    )
    show_latency(result)
    assert capsys.readouterr().out.count("\ngoal, coilcal") == 2

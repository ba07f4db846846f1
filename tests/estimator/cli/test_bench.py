"""`coilcal bench` at small sizes: every part is there, beside its peer, with its range; timings are not judged."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.benchmarks import fields, machine
from estimator.benchmarks.sessions import RIG
from tests.estimator.cli.conftest import run

CONFIGS = Path(__file__).parents[3] / "configs"
needs_magpylib = pytest.mark.skipif(find_spec("magpylib") is None, reason="magpylib is not installed")


def test_a_load_above_half_of_the_cores_is_warned_of(monkeypatch):
    monkeypatch.setattr(machine, "usable_cores", lambda: 4)
    for load, is_warned in ((1.9, False), (2.1, True)):
        monkeypatch.setattr(os, "getloadavg", lambda load=load: (load, 0.0, 0.0))
        printed = run("bench", "--tiny", "--repeats", 1, "--only", "fields")
        assert ("above half of the 4 cores" in printed.stderr) == is_warned


@needs_magpylib
def test_what_is_compared_is_the_same_field_and_the_same_derivatives():
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


def test_the_rig_of_the_wheel_is_that_of_the_checkout():
    assert RIG.read_bytes() == (CONFIGS / "paper_simulation.yaml").read_bytes()

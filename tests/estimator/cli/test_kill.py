"""kill -9 in the middle of sampling: the same command again gives, bit by bit, the chain of the run that was let alone."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from estimator.calibration.result import Calibration
from estimator.store.emcee_backend import ZarrBackend
from tests.estimator.cli.conftest import run
from tests.program import PROGRAM, ROOT

STEPS = 300


def command(session: Path, out: Path) -> list[str]:
    limits = ["--walkers", "16", "--ess", "1e9", "--max-steps", str(STEPS), "--seed", "3"]
    return ["calibrate", str(session), "--out", str(out), *limits]


def committed_steps(out: Path) -> int:
    try:
        return int(
            json.loads((out / "chain.zarr" / "zarr.json").read_text(encoding="utf-8"))["attributes"][
                "n_steps"
            ]
        )
    except FileNotFoundError:
        return 0


@pytest.mark.slow  # store/test_emcee_backend kills a chain, test_outputs interrupts this command
def test_a_killed_calibration_continues_to_the_same_posterior(workspace: Path, tmp_path: Path) -> None:
    session = workspace / "session.zarr"
    killed = subprocess.Popen(
        [*PROGRAM, *command(session, tmp_path / "killed")],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    while committed_steps(tmp_path / "killed") < 100:
        assert killed.poll() is None
        time.sleep(0.005)
    killed.kill()
    killed.communicate()
    survived = committed_steps(tmp_path / "killed")
    assert 100 <= survived < STEPS
    left = [path.name for path in (tmp_path / "killed").iterdir() if not path.name.startswith(".writer.")]
    assert left == ["chain.zarr"]

    for name in ("killed", "alone"):
        ended = run(*command(session, tmp_path / name))
        assert ended.exit_code == 4  # an effective sample size of 1e9 is never reached
        assert f"coilcal: sampling did not converge in {STEPS} steps" in ended.stderr
    chains = [ZarrBackend.open(tmp_path / name / "chain.zarr") for name in ("killed", "alone")]
    assert np.array_equal(chains[0].get_chain(), chains[1].get_chain())
    assert np.array_equal(chains[0].get_log_prob(), chains[1].get_log_prob())
    one, other = (Calibration.load(tmp_path / name) for name in ("killed", "alone"))
    assert one.summary() == other.summary()
    assert all(np.array_equal(draws, other.draws[name]) for name, draws in one.draws.items())

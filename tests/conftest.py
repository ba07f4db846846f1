"""Settings of every test run: no screen, one thread per worker, and the same examples each time."""

from __future__ import annotations

import os
from pathlib import Path

import matplotlib as mpl
import pytest
import torch
from hypothesis import settings

mpl.use("Agg")

# The workers of pytest-xdist share the cores: torch's own threads on top of them only wait for each other.
if "PYTEST_XDIST_WORKER" in os.environ:
    torch.set_num_threads(1)

# The first example of a test imports and compiles, so a deadline per example measures the machine.
settings.register_profile("coilcal", deadline=None, derandomize=True)
settings.load_profile("coilcal")

# Where simulated instruments, watchdogs and clusters run in processes of their own, a busy computer can miss a deadline.
HERE = Path(__file__).parent
REAL_TIME = (
    *(HERE / f"contract/test_{name}.py" for name in ("arms", "drivers", "replays")),
    HERE / "drivers",
    *(
        HERE / f"estimator/cli/test_{name}.py"
        for name in (
            "acquire",
            "acquire_faults",
            "acquire_general",
            "acquire_warm",
            "devices",
            "live",
            "rig_simulator",
        )
    ),
    HERE / "estimator/batching/test_engine.py",
    HERE / "estimator/test_refresh.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests against real time fail where they fail three times."""
    for item in items:
        if any(item.path == place or place in item.path.parents for place in REAL_TIME):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=2))

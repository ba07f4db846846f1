"""Settings of every test run: no screen, one thread per worker, and the same examples each time."""

from __future__ import annotations

import os

import matplotlib as mpl
import torch
from hypothesis import settings

mpl.use("Agg")

# The workers of pytest-xdist share the cores: torch's own threads on top of them only wait for each other.
if "PYTEST_XDIST_WORKER" in os.environ:
    torch.set_num_threads(1)

# The first example of a test imports and compiles, so a deadline per example measures the machine.
settings.register_profile("coilcal", deadline=None, derandomize=True)
settings.load_profile("coilcal")

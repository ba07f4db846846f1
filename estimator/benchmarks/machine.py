"""The machine of a measurement, in words."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("coilcal", "torch", "numpy", "numba", "emcee", "magpylib")
BUSY_SHARE = 0.5  # of the cores; above, timings include waiting for other work


def machine() -> dict[str, Any]:
    """Processor, usable cores, load of the last minute (None where the system does not say) and versions (None: not installed)."""
    return {
        "processor": processor(),
        "cores": usable_cores(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        **{name: _version(name) for name in PACKAGES},
    }


def is_busy(load: float | None, cores: int) -> bool:
    """Whether other work takes so much that timings are longer than on an idle machine."""
    return load is not None and load > BUSY_SHARE * cores


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor() -> str:
    """Name of the processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = (line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None

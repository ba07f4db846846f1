"""The machine of a benchmark: processor, usable cores and peak memory."""

from __future__ import annotations

import os
import platform
import resource
import sys
from pathlib import Path


def use_cores(number: int) -> int:
    """Restrict this process and its threads to a number of cores, if the system can; returns the number it may use."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:number])
        return len(os.sched_getaffinity(0))
    return number


def processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = (line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def peak_memory_GB() -> float:
    unit = (
        1e9 if sys.platform == "darwin" else 1e6
    )  # ru_maxrss is in bytes on macOS and in kilobytes elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit

"""The machine a benchmark runs on: its processor, the cores that it may use, and the memory that was needed."""

from __future__ import annotations

import os
import platform
import resource
import sys
from pathlib import Path


def use_cores(number: int) -> int:
    """Keep this process and all its threads on so many cores, where the system can."""
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
    unit = 1e9 if sys.platform == "darwin" else 1e6  # ru_maxrss counts bytes there and kilobytes elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit

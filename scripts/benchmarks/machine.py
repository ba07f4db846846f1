"""What a benchmark takes of the machine: cores and peak memory."""

from __future__ import annotations

import os
import resource
import sys


def use_cores(number: int) -> int:
    """Restrict this process and its threads to a number of cores, if the system can; returns the number it may use."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:number])
        return len(os.sched_getaffinity(0))
    return number


def peak_memory_GB() -> float:
    unit = (
        1e9 if sys.platform == "darwin" else 1e6
    )  # ru_maxrss is in bytes on macOS and in kilobytes elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit

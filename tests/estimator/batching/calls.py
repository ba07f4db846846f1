"""What workers are asked to do; they import this file and not torch."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def double(number: int) -> int:
    return 2 * number


def refuse(number: int) -> int:
    raise ValueError(f"{number} is refused")


def deadly_once(flag: str, number: int) -> int:
    if not Path(flag).exists():
        Path(flag).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def deadly() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def slowly(number: int) -> int:
    time.sleep(1.5)
    return 2 * number


def variable(name: str) -> str | None:
    return os.environ.get(name)

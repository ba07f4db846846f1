"""Which code produced a result: the commit, where it runs from a checkout; releases are told by their version."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PATIENCE_S = 10.0


@cache
def code_version() -> str | None:
    """Commit of the checkout that runs, with `-dirty` where files differ from it; None without a checkout or git."""
    if not (ROOT / ".git").exists():
        return None
    ask = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(ask, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None

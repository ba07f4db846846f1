"""What docs/file-formats.md promises: the keys in the tables of a section."""

from __future__ import annotations

import re
from pathlib import Path

FORMATS = Path(__file__).parents[1] / "docs" / "file-formats.md"
SUMMARY, DIAGNOSIS = "summary.json and posterior.zarr", "diagnosis.json and rig_extended.yaml"
COMMANDS, CAUSES, SERVICE = "Commands", "Names of causes", "The service"


def section(title: str) -> str:
    """One section of the page."""
    return FORMATS.read_text(encoding="utf-8").split(f"\n## {title}\n")[1].split("\n## ")[0]


def keys(title: str) -> list[str]:
    """Keys in the first column of the tables of a section, in their order."""
    cells = [line.split("|")[1] for line in section(title).splitlines() if line.startswith("| `")]
    return [key for cell in cells for key in re.findall(r"`([^`]+)`", cell)]

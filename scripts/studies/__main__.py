"""Run a study by its name in studies.yaml, or list them: `make study NAME=hidden`."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("studies.yaml")


def studies() -> dict[str, dict[str, Any]]:
    """What each study is, and the calls of Python that make it."""
    listed: dict[str, dict[str, Any]] = yaml.safe_load(LIST.read_text(encoding="utf-8"))
    return listed


def calls(study: dict[str, Any]) -> list[list[str]]:
    """Arguments of `python -m`, one list a call."""
    install = [["pip", "install", "-e", f".[{study['install']}]"]] if "install" in study else []
    return install + [shlex.split(line) for line in study["run"]]


def main(names: list[str]) -> None:
    """Run the calls of the named studies one after another; the first that fails ends it."""
    listed = studies()
    unknown = [name for name in names if name not in listed]
    if unknown or not names:
        print("\n".join(f"{name:24} {study['what']}" for name, study in listed.items()))
        sys.exit(f"no study is called {', '.join(unknown)}" if unknown else 0)
    for study in (listed[name] for name in names):
        environment = {**os.environ, **study.get("env", {})}
        for call in calls(study):
            subprocess.run([sys.executable, "-m", *call], cwd=ROOT, env=environment, check=True)


if __name__ == "__main__":
    main(sys.argv[1:])

"""A job as its worker has it.

Workers import this module without the web libraries, so those of another cluster need `coilcal[batch]` only.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from estimator.inference.ensemble import SamplerSettings
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.files import write_text
from estimator.store.session import Session, load_session

Tell = Callable[[str, Mapping[str, Any]], None]


@dataclass(frozen=True)
class AssignedJob:
    """A job with its folder.

    Attributes:
        content: Content of its `job.json`.
        folder: The folder.
        session_path: Folder of its session.
        tell: Reports progress, in words and numbers; raises where the job must end.
    """

    content: Mapping[str, Any]
    folder: Path
    session_path: Path
    tell: Tell

    @property
    def options(self) -> Mapping[str, Any]:
        """What was asked for."""
        return self.content["options"]

    @property
    def arguments(self) -> dict[str, Any]:
        """What was asked for, as the Python API takes it."""
        settings = self.options.get("settings")
        return {**self.options, **({} if settings is None else {"settings": SamplerSettings(**settings)})}

    @property
    def rig(self) -> Rig | None:
        """The rig that was given; None for that of the session."""
        text = self.content["rig"]
        return None if text is None else rig_from_text(text, "rig of the job")

    def session(self) -> Session:
        """The session."""
        return load_session(self.session_path)

    def command(self, name: str) -> str:
        """The command that would do the same, for the page."""
        flags = " --as-described" if self.options.get("as_described") else ""
        flags += "" if self.options.get("has_corrections", True) else " --no-corrections"
        job = f"job {self.content['id']} of coilcal serve"
        return f"coilcal {name} SESSION --seed {self.options['seed']}{flags}   ({job})"

    def write(self, name: str, content: Mapping[str, Any]) -> None:
        """Write a JSON file of the folder, whole or not at all."""
        write_text(self.folder / name, json.dumps(content, indent=2, allow_nan=False) + "\n")

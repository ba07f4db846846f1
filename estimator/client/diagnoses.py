"""The result of a diagnosis at a service, read as `estimator.Diagnosis` is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic

from estimator.client.calibrations import C
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text


@dataclass(frozen=True)
class RemoteDiagnosis(Generic[C]):
    """The result of a diagnosis.

    Attributes:
        diagnosis_json: Content of `diagnosis.json`.
        extended_rig_text: Text of `rig_extended.yaml`.
        posterior: The extended rig, sampled; None where that was not asked for or nothing was found.
    """

    diagnosis_json: Mapping[str, Any]
    extended_rig_text: str = field(repr=False)
    posterior: C | None

    def to_json(self) -> dict[str, Any]:
        """Content of `diagnosis.json`."""
        return dict(self.diagnosis_json)

    @property
    def verdict(self) -> str:
        """The outcome."""
        return str(self.diagnosis_json["verdict"])

    @property
    def extended_rig(self) -> Rig:
        """The rig with the named causes."""
        return rig_from_text(self.extended_rig_text, "rig_extended.yaml")

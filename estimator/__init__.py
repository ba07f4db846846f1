"""coilcal: calibrate electromagnet coils from measured readings, with credible intervals.

Examples:
    >>> from estimator import load_plan, load_rig, Session, simulate
    >>> rig = load_rig("configs/paper_simulation.yaml")
    >>> readings = simulate(rig, load_plan("configs/plans/paper_grid.yaml", rig), {"coil1.radius_m": 0.051}, seed=1)
    >>> session = Session(rig, readings, source="simulated")
    >>> len(session.observations.calibration)
    125
"""

from typing import TYPE_CHECKING, Any

from estimator.calibration.calibrate import Stage, calibrate
from estimator.calibration.result import Calibration
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.next_readings.design import Design, design
from estimator.diagnosis.result import Diagnosis
from estimator.errors import CoilcalError, CorruptStore, InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.live.stream import Estimate, Stream
from estimator.model.simulate import draw_truth, simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, load_plan
from estimator.readings.split import block_split
from estimator.recalibration.recalibrate import recalibrate, roll_back
from estimator.recalibration.registry import Entry, Registry
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.session import Session, load_session
from estimator.system.superposition import Superposition, superposition
from estimator.system.system import System, SystemField

if TYPE_CHECKING:
    from estimator.batching import batch

__all__ = [
    "Calibration",
    "CoilcalError",
    "CorruptStore",
    "Design",
    "Diagnosis",
    "Entry",
    "Estimate",
    "InvalidInput",
    "Observations",
    "Plan",
    "Registry",
    "Rig",
    "SamplerSettings",
    "Session",
    "Stage",
    "Stream",
    "Superposition",
    "System",
    "SystemField",
    "batch",
    "block_split",
    "calibrate",
    "design",
    "diagnose",
    "draw_truth",
    "load_plan",
    "load_rig",
    "load_session",
    "recalibrate",
    "roll_back",
    "simulate",
    "superposition",
]


def __getattr__(name: str) -> Any:
    """`batch` comes with Dask, which is an extra and slow to import: only where it is asked for."""
    if name == "batch":
        from estimator.batching import batch

        return batch
    raise AttributeError(f"module 'estimator' has no attribute {name!r}")

"""coilcal: calibrate electromagnet coils from measured readings, with credible intervals.

A public name loads its module when it is first used: torch alone takes two seconds, and `batch` needs the extra of that name.

Examples:
    >>> from estimator import load_plan, load_rig, Session, simulate
    >>> rig = load_rig("configs/paper_simulation.yaml")
    >>> readings = simulate(rig, load_plan("configs/plans/paper_grid.yaml", rig), {"coil1.radius_m": 0.051}, seed=1)
    >>> session = Session(rig, readings, source="simulated")
    >>> len(session.observations.calibration)
    125
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what type checkers and editors see; `_NAMES` says the same for the interpreter
    from estimator.batching import batch
    from estimator.calibration.calibrate import Stage, calibrate
    from estimator.calibration.result import Calibration
    from estimator.diagnosis.diagnose import diagnose
    from estimator.diagnosis.next_readings.design import Design, design
    from estimator.diagnosis.result import Diagnosis
    from estimator.effects import register_effect
    from estimator.errors import CoilcalError, CorruptStore, InvalidInput
    from estimator.inference.ensemble import SamplerSettings
    from estimator.live.stream import Estimate, Stream
    from estimator.model.simulate import draw_truth, simulate
    from estimator.planning.next_stop import NextStop, next_stop
    from estimator.planning.plan import plan
    from estimator.planning.planned import Planned
    from estimator.readings.observations import Observations
    from estimator.readings.plan import Plan, load_plan
    from estimator.readings.split import block_split
    from estimator.recalibration.log import Entry
    from estimator.recalibration.recalibrate import recalibrate, roll_back
    from estimator.recalibration.registry import Registry
    from estimator.rig.rig import Rig
    from estimator.rig_files.read import load_rig
    from estimator.store.session import Session, load_session
    from estimator.system.superposition import Superposition, superposition
    from estimator.system.system import System
    from estimator.system.system_field import SystemField

DISTRIBUTION = "coilcal"  # which `coilcal` looks for, before another package of this name runs in its place

__all__ = [
    "Calibration",
    "CoilcalError",
    "CorruptStore",
    "Design",
    "Diagnosis",
    "Entry",
    "Estimate",
    "InvalidInput",
    "NextStop",
    "Observations",
    "Plan",
    "Planned",
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
    "next_stop",
    "plan",
    "recalibrate",
    "register_effect",
    "roll_back",
    "simulate",
    "superposition",
]

_NAMES = {  # of each module
    "estimator.batching": ("batch",),
    "estimator.calibration.calibrate": ("Stage", "calibrate"),
    "estimator.calibration.result": ("Calibration",),
    "estimator.diagnosis.diagnose": ("diagnose",),
    "estimator.diagnosis.next_readings.design": ("Design", "design"),
    "estimator.diagnosis.result": ("Diagnosis",),
    "estimator.effects": ("register_effect",),
    "estimator.errors": ("CoilcalError", "CorruptStore", "InvalidInput"),
    "estimator.inference.ensemble": ("SamplerSettings",),
    "estimator.live.stream": ("Estimate", "Stream"),
    "estimator.model.simulate": ("draw_truth", "simulate"),
    "estimator.planning.next_stop": ("NextStop", "next_stop"),
    "estimator.planning.plan": ("plan",),
    "estimator.planning.planned": ("Planned",),
    "estimator.readings.observations": ("Observations",),
    "estimator.readings.plan": ("Plan", "load_plan"),
    "estimator.readings.split": ("block_split",),
    "estimator.recalibration.log": ("Entry",),
    "estimator.recalibration.recalibrate": ("recalibrate", "roll_back"),
    "estimator.recalibration.registry": ("Registry",),
    "estimator.rig.rig": ("Rig",),
    "estimator.rig_files.read": ("load_rig",),
    "estimator.store.session": ("Session", "load_session"),
    "estimator.system.superposition": ("Superposition", "superposition"),
    "estimator.system.system": ("System",),
    "estimator.system.system_field": ("SystemField",),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module 'estimator' has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names, loaded or not, beside what the module holds."""
    return sorted({*globals(), *__all__})

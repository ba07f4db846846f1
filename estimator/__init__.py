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
from typing import Any

DISTRIBUTION = "coilcal"  # tells `coilcal` that this package, and no other of the same name, was imported

_NAMES = {  # of each module; `__init__.pyi` says the same to type checkers and editors
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
__all__ = sorted(_MODULES)  # noqa: PLE0605


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

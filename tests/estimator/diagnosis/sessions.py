"""Small simulated sessions with a hidden cause, and the plain rig fitted to them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from estimator import Session, load_plan, load_rig, simulate
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations

RIG = load_rig("configs/paper_simulation.yaml")
TRUTH = {
    "coil1.radius_m": 0.051,
    "coil1.wire_radius_m": 0.00049,
    "coil1.axial_loops": 48.0,
    "coil1.radial_loops": 25.0,
    "hall.noise_T": 20e-6,
}
PLAN = """
schema_version: 1
name: a grid at three currents
poses:
  calibration:
    arm1: {x_mm: {from: -40, to: 40, count: 4}, y_mm: {from: -40, to: 40, count: 4}, z_mm: {from: -15, to: 20, count: 3}}
currents_A: CURRENTS
order: random
settle_s: 2
"""


@lru_cache
def session_with(hidden: tuple[tuple[str, float], ...], currents_A: tuple[float, ...], seed: int) -> Session:
    """48 positions at each of the currents."""
    text = PLAN.replace("CURRENTS", str([{"coil1": current} for current in currents_A]))
    folder = Path(_folder())
    plan = folder / f"{abs(hash(text))}.yaml"
    plan.write_text(text)
    readings = simulate(RIG, load_plan(plan, RIG), TRUTH, seed, dict(hidden))
    return Session(RIG, readings, "simulated")


@lru_cache
def plain_fit(
    hidden: tuple[tuple[str, float], ...] = (),
    currents_A: tuple[float, ...] = (3.0, -3.0, 1.5),
    seed: int = 1,
) -> Fit:
    """Fit of the rig without the hidden cause."""
    observations = session_with(hidden, currents_A, seed).observations
    return fit_rig(RIG, observations, TRUTH, MeasurementModel.build(RIG, observations).rules)


def together(first: Observations, more: Observations) -> Observations:
    """One session and, hours later, another."""
    return first.followed_by(replace(more, time_s=1e4 + more.time_s))


@lru_cache
def _folder() -> str:
    from tempfile import mkdtemp

    return mkdtemp()

"""A rig on which every cause acts somewhere, and what the model predicts with each; imports no torch, so that it also runs on NumPy.

`python -m tests.every_cause FILE` computes on NumPy and writes what `predictions` returns.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

RIG = """
schema_version: 1
name: two coils
movers:
  arm1: {motion: displacement}
  arm2: {motion: UR3e, world_from_base: {x_mm: 537, y_mm: 223, z_mm: -66}}
coils:
  coil1:
    carried_by: arm1
    radius_mm: {prior: {normal: {mean: 40, sd: 1}}}
    wire_radius_mm: 0.5
    axial_loops: 6
    radial_loops: 4
    superconducting: true
    world_from_coil0: {z_mm: -45, tilt_x_deg: 2}
  coil2: {carried_by: arm2, radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3}
sensors:
  hall: {noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}}
  other: {noise_uT: 5, world_from_sensor: {y_mm: 15, rx_deg: 90}}
"""


def predictions() -> dict[str, np.ndarray]:
    """Readings and fields in the room that the model predicts, by the cause that acts."""
    from estimator.effects import EFFECTS
    from estimator.effects.attach import with_effect
    from estimator.effects.circumstances import Circumstances
    from estimator.model.measurement_model import MeasurementModel
    from estimator.model.room_field import RoomField
    from estimator.rig.rig import Cause
    from estimator.rig_files.read import rig_from_text
    from estimator.tensors import torch

    described = rig_from_text(RIG)
    readings = observed()
    predicted: dict[str, np.ndarray] = {}
    for name, effect in EFFECTS.items():
        for place in effect.places(described)[-1:]:
            circumstances = Circumstances(described, readings)
            rig = with_effect(described, Cause(name, place), readings, effect.starts(circumstances, place)[0])
            numbers = rig.nominal_values()
            for quantity in effect.quantities(circumstances.extent):
                if not quantity.is_fixed and not quantity.is_shape:
                    numbers[f"{name}[{place}].{quantity.key}"] = quantity.null + 0.7 * quantity.prior.sd
            values = {key: torch.tensor(value, dtype=torch.float64) for key, value in numbers.items()}
            predicted[f"{name}[{place}]"] = MeasurementModel.build(rig, readings).predict(values).numpy()
            points_m = torch.tensor([[0.0, 0.01, 0.05], [0.2, 0.0, 0.1]], dtype=torch.float64)
            current_A = torch.tensor([2.0, -1.0], dtype=torch.float64)
            predicted[f"{name}[{place}] in the room"] = (
                RoomField(rig, values, points_m).field_T(values, current_A).numpy()
            )
    return predicted


def observed() -> Any:
    """Readings of two sensors with all that causes ask for: moves, currents of both signs, temperatures, segments."""
    from estimator.readings.observations import Observations
    from estimator.tensors import torch

    n, random = 24, np.random.default_rng(3)
    motion = torch.zeros(n, 6, dtype=torch.float64)
    motion[:, :3] = torch.from_numpy(0.02 * (random.random((n, 3)) - 0.5))
    currents_A = np.stack((np.tile([2.0, -2.0, 1.0, 0.0], 6), np.tile([0.0, 0.0, 1.0], 8)), axis=1)
    return Observations.of(
        torch.from_numpy(currents_A),
        {"arm1": motion, "arm2": motion.flip(-1)},
        torch.from_numpy(1e-3 * random.standard_normal((n, 3))),
        time_s=2.0 * torch.arange(n, dtype=torch.float64),
        sensor=torch.arange(n) % 2,
        temperature_C={
            name: torch.from_numpy(20.0 + random.random(n)) for name in ("hall", "other", "coil1")
        },
        recorded_segment=torch.arange(n) // 9,
    )


if __name__ == "__main__":
    from estimator.tensors import compute_on_numpy

    assert compute_on_numpy()
    np.savez(Path(sys.argv[1]), **predictions())
    assert "torch" not in sys.modules

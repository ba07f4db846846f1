"""Causes as the independent generator of hidden flaws has them: the same readings, from the same numbers, by other code.

Where a cause has more to it than one formula, the other files here say what it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.flaw import Flaw, Truth, record
from tests.hidden.library import ALL
from tests.hidden.scene import Scene
from tests.hidden.session import draw_session
from tests.hidden.study import TRANSLATED

Numbers = Mapping[str, float]
TOLERANCE = 1e-6  # of what the cause does: the two codes round mu0 differently in its tenth digit


def moved(known: Numbers) -> Numbers:
    return {f"{a}_m": known[f"shift_{a}_m"] for a in "xyz"} | {
        f"r{a}_rad": known[f"turn_{a}_rad"] for a in "xyz"
    }


SAME = (
    *("background_field", "background_drift", "sensor_offset", "offset_drift", "axis_gain", "cross_axis"),
    *(
        "cubic_response",
        "planar_hall",
        "range_clipping",
        "temperature_drift",
        "current_offset",
        "neighbour_coil",
    ),
    *("spherical_sum", "robot_scale", "robot_shear", "position_lag", "mount_tilt"),
)
NUMBERS: dict[str, Callable[[Numbers], Numbers]] = {
    **{name: TRANSLATED[name] for name in SAME},
    "current_gain": lambda known: {"excess": known["gain"] - 1.0},
    "current_remanence": lambda known: known,
    "axial_pitch": lambda known: {"excess": known["factor"] - 1.0},
    "radial_pitch": lambda known: {"excess": known["factor"] - 1.0},
    "turns_gradient": lambda known: {"slope": known["gradient"]},
    "iron_body": lambda known: {"volume_m3": known["radius_m"] ** 3} | {f"{a}_m": known[f"position_{a}_m"] for a in "xyz"},
    "sensor_misplaced": moved,
    "coil_misplaced": moved,
    "element_displacement": lambda known: {key.replace("_element_", "_at_"): at_m for key, at_m in known.items()},
}  # fmt: skip


@pytest.fixture(scope="module", params=["recommended", "paper"])
def laboratory(request, tmp_path_factory) -> tuple[str, Scene, Rig, Observations]:
    """A scene of the generator without a flaw, and what coilcal is told of it."""
    hidden = draw_session(7, None, protocol=request.param)
    folder: Path = tmp_path_factory.mktemp(request.param)
    hidden.write(folder)
    rig = load_rig(folder / "rig.yaml")
    readings = read_readings_csv(folder / "readings.csv", rig).observations
    rig = rig.with_values({name: float(value) for name, value in hidden.truth()["values"].items()})
    return request.param, hidden.scene, rig, readings


def predicted_T(rig: Rig, readings: Observations, truth: Truth, name: str) -> np.ndarray:
    numbers = NUMBERS[name]({known.name: float(known.value) for known in truth.parameters})
    with_cause = with_effect(rig, Cause(name, truth.place), readings, numbers, is_free=False)
    model = MeasurementModel.build(with_cause, readings, 1e-9)
    values = {k: torch.tensor(v, dtype=torch.float64) for k, v in with_cause.nominal_values().items()}
    return model.predict(values).expand(len(readings), 3).numpy()


@pytest.mark.parametrize("name", NUMBERS)
def test_a_cause_does_to_the_readings_what_the_generator_does(laboratory, name):
    protocol, scene, rig, readings = laboratory
    cause = ALL[name]
    if protocol not in cause.protocols:
        pytest.skip("it cannot happen there")
    for seed in range(3):  # which also draws axes and signs
        flawed = record(scene, [Flaw(cause, 0.3 * cause.largest, seed)])
        (truth,) = flawed.truths
        effect_T = np.abs(flawed.field_T - record(scene, []).field_T).max()
        error_T = np.abs(predicted_T(rig, readings, truth, name) - flawed.field_T).max()
        assert error_T < TOLERANCE * effect_T

"""A contact that works otherwise on one side is found at a sensor that was read on a small part of the way."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.hypotheses.candidates import causes_of
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from tests.estimator.diagnosis.mixture.weighed import weighed
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T, with_wrong

CONTACT = Cause("sensor_contact", "hall")
SIZE = {"x_T": 60e-6, "y_T": -40e-6, "along": 0.0, "side": -1.0}
N_OWN, N = 8, 60  # no sixth of all readings lies between those of one sensor
ROW = 4  # the first beyond the place
NAMES = ("sensor_contact", "sensor_offset", "axis_gain", "cross_axis")


def readings_along_x(sensor: torch.Tensor) -> Observations:
    """The arm goes 120 mm along x, and a little along the other axes."""
    along = torch.linspace(0.0, 1.0, N, dtype=torch.float64)
    motion = torch.zeros(N, 6, dtype=torch.float64)
    motion[:, 0] = 0.12 * along - 0.06
    motion[:, 1], motion[:, 2] = 0.02 * torch.sin(17.0 * along), 0.015 * torch.cos(23.0 * along)
    current_A, field_T = torch.full((N, 1), 3.0).double(), torch.zeros(N, 3).double()
    return Observations.of(current_A, {"arm1": motion}, field_T, sensor=sensor)


@pytest.mark.whole
def test_hidden_contact_of_a_sensor_read_on_a_small_part_of_the_way_is_found(rig_text, small_truth):
    rig = rig_from_text(rig_text + "  other: {noise_uT: 5, world_from_sensor: {y_mm: 10}}\n")
    truth = rig.with_values(small_truth)
    readings = readings_along_x((torch.arange(N) >= N_OWN).long())
    x_m = readings.motion["arm1"][:, 0]
    beyond_m = 0.5 * float(x_m[ROW - 1] + x_m[ROW])
    noise_T = 5e-6 * torch.randn(N, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(150_411))
    readings = readings.with_field(predicted_T(truth, readings) + noise_T)
    fit = fit_of(rig, with_wrong(truth, readings, CONTACT, {**SIZE, "beyond_m": beyond_m}))
    asked = [cause for cause in causes_of(rig, fit) if cause.name in NAMES]
    told = weighed(fit, asked)
    best = max(told, key=lambda cause: told[cause][0])
    assert best == CONTACT
    assert all(told[CONTACT][0] > value + 5.0 for cause, (value, _) in told.items() if cause != CONTACT)
    shapes = told[CONTACT][1].start
    assert shapes["along"] == 0.0
    assert float(x_m[ROW - 1]) < shapes["beyond_m"] < float(x_m[ROW])

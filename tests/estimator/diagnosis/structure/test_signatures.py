from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.structure.signatures import _are_flat, leading, signatures
from tests.estimator.diagnosis.sessions import plain_fit

pytestmark = pytest.mark.whole

Hidden = tuple[tuple[str, float], ...]


def test_pure_noise_has_no_signature():
    signature = signatures(plain_fit())
    assert [
        leading(evidence) for evidence in (signature.stays_with, signature.current, signature.field_equations)
    ] == [[], [], []]


@pytest.mark.parametrize(
    ("hidden", "current"),
    [
        ((("sensor_offset.z_T", 200e-6),), "independent"),
        ((("axis_gain.x", 0.02),), "odd"),
        ((("planar_hall.z_per_T", 3.0),), "even"),
        ((("core_saturation.share", 0.1), ("core_saturation.loss_per_A2", 5e-3)), "cubic"),
    ],
)
def test_parity_in_the_current_is_that_of_the_cause(hidden, current):
    assert leading(signatures(plain_fit(hidden)).current) == [current]


@pytest.mark.parametrize(
    ("hidden", "answer"),
    [
        ((("coil_ovality.cos2", 0.02),), "a magnetic field"),
        ((("iron_core.share", 0.1),), "a magnetic field"),
        ((("axis_gain.x", 0.02),), "no magnetic field"),
        ((("cross_axis.xy", 0.02),), "no magnetic field"),
    ],
)
def test_only_sources_obey_the_field_equations(hidden, answer):
    assert leading(signatures(plain_fit(hidden)).field_equations) == [answer]


def test_places_on_a_line_or_in_a_plane_ask_nothing_of_the_field_equations_however_they_are_turned():
    along = torch.linspace(0.0, 0.3, 20, dtype=torch.float64)
    tilted = torch.linalg.qr(torch.tensor([[1.0, 0.02, 0.0], [0.01, 1.0, 0.03], [0.0, 0.0, 1.0]])).Q.double()
    line_m = torch.stack((along, 0.0 * along, 0.0 * along), dim=1) @ tilted
    plane_m = torch.stack((along, along**2, 0.0 * along), dim=1) @ tilted
    assert _are_flat(line_m)
    assert _are_flat(plane_m)
    assert not _are_flat(torch.stack((along, along**2, along**3), dim=1) @ tilted)


@pytest.mark.parametrize(
    ("hidden", "answer"),
    [
        ((("cubic_response.z_per_T2", -100.0),), "sensor"),
        ((("offset_drift.x_T_per_h", 4e-3),), "clock"),
        ((("sensor_offset.z_T", 60e-6),), "constant"),
        ((("iron_core.share", 0.1),), "coil1"),
    ],
)
def test_the_residual_stays_with_what_is_wrong(hidden, answer):
    assert answer in leading(signatures(plain_fit(hidden)).stays_with)
    assert "path" not in leading(signatures(plain_fit(hidden)).stays_with)


def test_with_one_current_parity_is_not_asked():
    assert signatures(plain_fit(currents_A=(3.0,))).current is None

"""First derivatives of `first_order_field` against those of the plain field, in everything that moves a coil's field."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.func import jacfwd

from estimator.derivatives import jacobian_of
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.stages import SourceEffect, WindingMagnetisation
from estimator.field.node_sum import SumMode
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text

pytestmark = pytest.mark.whole

RIG = """
schema_version: 1
name: a free winding, a fixed one, and iron
movers: {stage: {motion: pose}}
coils:
  coil1:
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: {prior: {normal: {mean: 0.49, sd: 0.01, lower: 0.2}}}
    axial_loops: {prior: {normal: {mean: 12, sd: 1, lower: 1}}}
    radial_loops: {prior: {normal: {mean: 8, sd: 0.5, lower: 1}}}
    world_from_coil: {z_mm: {prior: {normal: {mean: -40, sd: 2}}}, tilt_x_deg: {prior: {normal: {mean: 0, sd: 2}}}}
  coil2: {radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 6, radial_loops: 4, world_from_coil: {x_mm: 90, ry_deg: -90}}
sensors:
  a: {noise_uT: 20, carried_by: stage, flange_from_sensor: {z_mm: {prior: {normal: {mean: 5, sd: 1}}}}}
  b: {noise_uT: 20, carried_by: stage, flange_from_sensor: {y_mm: 9}}
effects:
  iron_body[room]:
    volume_m3: {prior: {normal: {mean: 2.0e-6, sd: 1.0e-6}}}
    x_m: {prior: {normal: {mean: 0.09, sd: 0.02}}}
    y_m: 0.05
    z_m: 0.06
  element_displacement[b]:
    {x_at_x_m: 0, x_at_y_m: 3.0e-4, x_at_z_m: 0, y_at_x_m: 0, y_at_y_m: {prior: {normal: {mean: 0, sd: 5.0e-4}}}, y_at_z_m: 0,
    z_at_x_m: 0, z_at_y_m: 0, z_at_z_m: -4.0e-4}
"""


SOURCES = [
    name for name, effect in EFFECTS.items() if isinstance(effect, SourceEffect | WindingMagnetisation)
]


@pytest.fixture(scope="module")
def observations() -> Observations:
    """Two sensors turned and moved at random, with one coil on, the other, or both."""
    random = np.random.default_rng(3)
    motion = np.concatenate((random.uniform(-0.02, 0.02, (8, 3)), random.normal(size=(8, 3))), axis=1)
    current_A = torch.tensor([[1.0, 0.0], [1.0, 0.5], [0.0, 2.0], [-1.0, 0.0]] * 2, dtype=torch.float64)
    return Observations.of(current_A, {"stage": torch.from_numpy(motion)}, sensor=torch.arange(8) % 2)


@pytest.mark.parametrize(
    "radius", ["{prior: {normal: {mean: 51, sd: 1}}}", "51"], ids=["free", "fixed radius"]
)
def test_first_order_field_has_the_value_and_the_derivatives_of_the_plain_field(observations, radius):
    agree(rig_from_text(RIG.replace("{prior: {normal: {mean: 51, sd: 1}}}", radius)), observations)


@pytest.mark.parametrize("source", SOURCES)
def test_field_that_moves_with_a_coil_has_the_derivatives_of_the_plain_field(observations, source):
    rig = rig_from_text(RIG)
    for coil in ("coil1", "coil2"):
        rig = with_effect(rig, Cause(source, coil), observations, {})
    agree(rig, observations)


def agree(rig: Rig, observations: Observations) -> None:
    """Both models agree in value and derivatives at a draw from the prior."""
    coordinates = Coordinates(rig)
    plain = MeasurementModel.build(rig, observations)
    first_order = plain.with_mode(SumMode.FIRST_ORDER)
    vector = coordinates.sample_prior(np.random.default_rng(4), 1)[0]
    values = [model.predict(coordinates.values(vector)) for model in (plain, first_order)]
    # Rings of dipoles are differences of loops 1e-5 radii apart, which magnify rounding.
    torch.testing.assert_close(values[1], values[0], rtol=1e-11, atol=0.0)
    jacobians = [
        jacfwd(lambda v: plain.predict(coordinates.values(v)))(vector),
        jacobian_of(lambda v: first_order.predict(coordinates.values(v)), vector),
    ]
    moves = torch.tensor([".noise" not in name for name in coordinates.names])
    assert (jacobians[0].flatten(0, 1).norm(dim=0)[moves] > 0.0).all()
    torch.testing.assert_close(
        jacobians[1], jacobians[0], rtol=1e-10, atol=1e-11 * float(jacobians[0].abs().max())
    )

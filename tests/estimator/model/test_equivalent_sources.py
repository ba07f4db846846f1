"""Coils as charges on a box in the model: where they have no field, on another device, and beside a ball of harmonics at hidden magnets."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.model.coil_field import unwound_field
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.model.test_unwound import readings
from tests.far import far_device

TEXT = """
schema_version: 1
name: box
movers: {stage: {motion: pose}}
coils:
  c1:
    model: equivalent_sources
    half_x_mm: 5
    half_y_mm: 5
    half_z_mm: 5
    margin_mm: 4
    spacing_mm: 1.8
    amplitudes: {sd_T_per_A: 1e-3}
    world_from_coil: {x_mm: 10}
sensors: {hall: {carried_by: stage, noise_uT: 1}}
"""
BALL = """
schema_version: 1
name: ball
movers: {stage: {motion: pose}}
coils:
  c1: {model: harmonic, region: interior, degree: 14, reference_radius_mm: 8.66, amplitudes: {sd_T_per_A: 1e-3, falloff: 0.7}}
sensors: {hall: {carried_by: stage, noise_uT: 1}}
"""
NOISE_T = 1e-8


def test_readings_beyond_half_the_margin_are_refused():
    rig = rig_from_text(TEXT)
    MeasurementModel.build(rig, readings([[0.0169, 0.0, 0.005]], [1.0]))
    with pytest.raises(
        InvalidInput, match=r"no more than 0.5 of the margin, 4 mm, beyond the box of c1, 10 x 10 x 10 mm"
    ):
        MeasurementModel.build(rig, readings([[0.010, 0.0, 0.0], [0.0, 0.0, 0.0071]], [1.0]))


def test_the_room_has_no_field_near_the_charges_and_beyond():
    rig = rig_from_text(TEXT).with_values({"c1.charge1_T_per_A": 1e-3})
    values = nominal_tensors(rig)
    points_m = torch.tensor(
        [[0.01, 0.0, 0.0], [0.0031, 0.0, 0.0], [0.0029, 0.0, 0.0], [0.1, 0.0, 0.0]]
    ).double()
    current_A = torch.ones(1).double()
    field_T = RoomField(rig, values, points_m).field_T(values, current_A)
    assert torch.isnan(field_T).all(-1).tolist() == [False, False, True, True]
    with far_device() as far:
        there = {name: value.to(far) for name, value in values.items()}
        far_T = RoomField(rig, there, points_m.to(far)).field_T(there, current_A.to(far))
        assert far_T.device == far
        torch.testing.assert_close(far_T.cpu(), field_T, equal_nan=True)


def test_nearer_to_a_multipole_than_the_box_readings_are_refused_and_the_room_has_no_field():
    rig = rig_from_text(TEXT.replace("spacing_mm: 1.8", "spacing_mm: 1.8\n    multipoles_mm: [[0, 0, 6]]"))
    MeasurementModel.build(rig, readings([[0.010, 0.0, 0.005], [0.013, 0.0, 0.0055]], [1.0]))
    with pytest.raises(InvalidInput, match="no nearer to a multipole of c1 than its box does"):
        MeasurementModel.build(rig, readings([[0.010, 0.0, 0.0055]], [1.0]))
    points_m = torch.tensor([[0.010, 0.0, 0.005], [0.010, 0.0, 0.0055]]).double()
    values = nominal_tensors(rig.with_values({"c1.multipole1_degree1_cos0_T_per_A": 1e-3}))
    field_T = RoomField(rig, values, points_m).field_T(values, torch.ones(1).double())
    assert torch.isnan(field_T).all(-1).tolist() == [False, True]
    assert float(field_T[0].norm()) == pytest.approx(1e-3 * 2.0**0.5 / 3.0**0.5)  # on the axis of a dipole


def columns(rig: Rig, points_m: Tensor) -> Tensor:
    """Components of the field at points, by prior standard deviations of each amplitude."""
    names = [name for own in rig.unwound[0].amplitudes.values() for name in own]
    sds = torch.tensor([p.sd for name in names if (p := rig.parameters[name].prior) is not None]).double()
    values = nominal_tensors(rig) | dict(zip(names, torch.diag(sds), strict=True))
    return unwound_field(rig.unwound[0], values).by(None)(points_m).flatten(1).T


@pytest.mark.whole
def test_magnets_beside_the_box_are_followed_into_the_corners():
    """Three magnets 2 mm off a face, by posterior means without the corners: a ball that holds the corners holds the magnets too."""
    axis = torch.linspace(-5e-3, 5e-3, 8).double()
    places_m = torch.cartesian_prod(axis, axis, axis)
    is_corner = (places_m.abs() > 4.9e-3).all(-1)
    field_T = torch.stack([field_of_a_magnet(seed, places_m) for seed in (150100, 150101, 150102)])
    seen_T, corner_T = field_T[:, ~is_corner].flatten(1).T, field_T[:, is_corner].flatten(1).T
    errors = []
    for text in (TEXT.replace("{x_mm: 10}", "{}").replace("spacing_mm: 1.8", "spacing_mm: 1.3"), BALL):
        rig = rig_from_text(text)
        left, size, right = np.linalg.svd(columns(rig, places_m[~is_corner]).numpy(), full_matrices=False)
        mean = right.T @ ((size / (size**2 + NOISE_T**2))[:, None] * (left.T @ seen_T.numpy()))
        error_T = columns(rig, places_m[is_corner]).numpy() @ mean - corner_T.numpy()
        errors.append(np.linalg.norm(error_T, axis=0) / np.linalg.norm(corner_T.numpy(), axis=0))
    in_box, in_ball = errors
    assert in_box.max() < 0.03
    assert np.exp(np.log(in_box / in_ball).mean()) < 0.6


def field_of_a_magnet(seed: int, places_m: Tensor) -> Tensor:
    """With rms 1 mT; of a magnet 2 mm above the upper face of the box."""
    rng = np.random.default_rng(seed)
    size_mm = rng.uniform(4.0, 12.0, 3)
    place_mm = np.append(rng.uniform(-4.0, 4.0, 2), 7.0 + 0.5 * size_mm[2])
    magnet = magpylib.magnet.Cuboid(
        dimension=1e-3 * size_mm, position=1e-3 * place_mm, polarization=rng.normal(size=3)
    )
    field_T = torch.from_numpy(magnet.getB(places_m.numpy()))
    return 1e-3 * field_T / field_T.square().sum(-1).mean().sqrt()

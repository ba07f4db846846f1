"""Fields along a bore: no divergence, no curl, their size where sources begin, Bessel functions, and loops outside that they follow."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
import torch
from scipy.special import iv
from torch import Tensor
from torch.func import jacfwd, vmap

from estimator.field.bore import MOST_TURNS, SOURCES, WAVES, bore_field

LENGTH = 10.0  # in radii
WAVE = torch.eye(len(WAVES), dtype=torch.float64)


def cylinder(n: int, seed: int, radius: float = 1.0, length: float = LENGTH) -> Tensor:
    """Points in it, evenly."""
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, n), radius * np.sqrt(rng.uniform(0.0, 1.0, n))
    z = length * rng.uniform(-0.5, 0.5, n)
    return torch.from_numpy(np.stack((r * np.cos(angle), r * np.sin(angle), z), axis=1))


@pytest.mark.parametrize("degree", [0, 1, 7, 25])
def test_fields_have_neither_divergence_nor_curl(degree):
    each = torch.eye(8, dtype=torch.float64)

    def fields(point: Tensor) -> Tensor:
        if degree == 0:
            return bore_field(point[None], LENGTH, each, {})[:, 0]
        return bore_field(point[None], LENGTH, None, {degree: WAVE})[:, 0]

    slope = vmap(jacfwd(fields))(cylinder(9, degree))  # point, term, component, axis
    largest = float(slope.abs().max())
    assert largest > 1e-3
    assert float(torch.diagonal(slope, dim1=-2, dim2=-1).sum(-1).abs().max()) < 1e-12 * largest
    assert float((slope - slope.mT).abs().max()) < 1e-12 * largest


@pytest.mark.parametrize("degree", [1, 4, 12])
def test_waves_have_rms_one_where_sources_begin(degree):
    angle = 2.0 * np.pi * (np.arange(32) / 32)[:, None]
    z = LENGTH * ((np.arange(100) + 0.5) / 100 - 0.5)
    wall = np.stack(np.broadcast_arrays(np.cos(angle), np.sin(angle), z), axis=-1).reshape(-1, 3)
    wall = wall * np.array([SOURCES, SOURCES, 1.0])
    fields = bore_field(torch.from_numpy(wall), LENGTH, None, {degree: WAVE})
    rms = fields.square().sum(-1).mean(-1).sqrt()
    torch.testing.assert_close(rms, torch.ones_like(rms), rtol=0.0, atol=1e-12)


def test_a_wave_is_a_modified_bessel_function_across_the_bore():
    """B_z of n half waves with m turns is proportional to I_m(k r); by SciPy."""
    n, radii = 6, np.array([0.2, 0.5, 0.9, 1.6])
    points = torch.from_numpy(np.stack((radii, 0.0 * radii, 0.0 * radii), axis=1))
    k = n * np.pi / LENGTH
    for m in range(MOST_TURNS + 1):
        wave = WAVE[WAVES.index(f"cos{m}")]
        along = bore_field(points, LENGTH, None, {n: wave})[:, 2].numpy()
        np.testing.assert_allclose(along / along[0], iv(m, k * radii) / iv(m, k * radii[0]), rtol=1e-13)


def test_loops_outside_are_followed_where_a_ball_would_hold_them():
    """A loop about the bore and a tilted one beside it, by magpylib: from half of the places to the others."""
    around = magpylib.current.Circle(diameter=5.0, current=1.0, position=(0.0, 0.0, 1.3))
    beside = magpylib.current.Circle(diameter=1.5, current=60.0, position=(0.0, 6.0, -2.0)).rotate_from_angax(
        50, "x"
    )
    points = cylinder(1200, 3, length=LENGTH - 2.0)
    field = torch.from_numpy(magpylib.getB([around, beside], points.numpy(), sumup=True))
    each = torch.eye(8, dtype=torch.float64)
    columns = [bore_field(points, LENGTH, each, {})]
    columns += [bore_field(points, LENGTH, None, {degree: WAVE}) for degree in range(1, 17)]
    design = torch.cat(columns).flatten(1).T
    is_fitted = (torch.arange(len(points)) % 2 == 0).repeat_interleave(3)
    held_out = []
    for n_columns in (8 + 4 * len(WAVES), design.shape[1]):
        some = design[:, :n_columns]
        amplitude = torch.linalg.lstsq(some[is_fitted], field.flatten()[is_fitted, None]).solution
        error = field.flatten()[~is_fitted] - (some[~is_fitted] @ amplitude)[:, 0]
        held_out.append(float(error.norm() / field.flatten()[~is_fitted].norm()))
    assert held_out[0] > 3e-2
    assert held_out[1] < 1e-3


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_many_amplitudes_at_the_same_points_have_the_fields_of_each_alone(batch):
    rng = np.random.default_rng(150_000)
    points = cylinder(12, 7).reshape(*batch, -1, 3)
    ones = (1,) * len(batch)
    trend, first, second = (torch.from_numpy(rng.normal(size=(5, *ones, n))) for n in (8, 13, 13))
    together = bore_field(points, LENGTH, trend, {1: first, 4: second})
    alone = [
        bore_field(points, LENGTH, a.flatten(), {1: b.flatten(), 4: c.flatten()})
        for a, b, c in zip(trend, first, second, strict=True)
    ]
    assert together.shape == (5, *points.shape)
    torch.testing.assert_close(
        together, torch.stack(alone), rtol=0.0, atol=1e-14 * float(together.abs().max())
    )

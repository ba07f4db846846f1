"""Field of magnetic charges on a box: against a plain sum, the laws it obeys, and what its scale and its total charge mean."""

from __future__ import annotations

import itertools

import magpylib
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.func import jacrev, vmap

from estimator.field.charged_box import SIZES, charge_places, charged_box_field, multipole_field
from estimator.rig.charged_box import intervals, n_charges

HALF_M = (0.02, 0.015, 0.03)
N = (5, 4, 7)


def inside(n: int) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    share = 2.0 * torch.rand(n, 3, generator=generator, dtype=torch.float64) - 1.0
    return 0.7 * share * torch.tensor(HALF_M, dtype=torch.float64)


def columns(half_m: tuple[float, float, float], n: tuple[int, int, int], points_m: Tensor) -> Tensor:
    """Field of each charge alone, as a matrix of components by charges."""
    each = torch.eye(n_charges(n), dtype=torch.float64)
    return charged_box_field(points_m, half_m, n, each).flatten(1).T


def test_it_is_the_sum_of_the_fields_of_single_charges():
    steps = [np.linspace(-half, half, n + 1) for half, n in zip(HALF_M, N, strict=True)]
    places = [p for p in itertools.product(*steps) if max(abs(np.array(p)) / HALF_M) > 1.0 - 1e-9]
    assert len(places) == n_charges(N)
    amplitudes = np.random.default_rng(0).normal(size=len(places))
    scale = 1.0 / np.sqrt(sum(np.dot(p, p) ** -2 for p in places))
    points_m = inside(10)
    expected = np.zeros((10, 3))
    for place, amplitude in zip(places, amplitudes, strict=True):
        away = points_m.numpy() - place
        expected += scale * amplitude * away / np.linalg.norm(away, axis=1, keepdims=True) ** 3
    field = charged_box_field(points_m, HALF_M, N, torch.from_numpy(amplitudes))
    np.testing.assert_allclose(field.numpy(), expected, rtol=1e-11, atol=1e-14 * np.abs(expected).max())


def test_divergence_and_curl_vanish():
    amplitudes = torch.randn(n_charges(N), generator=torch.Generator().manual_seed(1)).double()

    def at(point_m: Tensor) -> Tensor:
        return charged_box_field(point_m[None], HALF_M, N, amplitudes)[0]

    gradient = vmap(jacrev(at))(inside(20))
    size = gradient.abs().amax((-1, -2))
    assert (gradient.diagonal(dim1=-2, dim2=-1).sum(-1).abs() / size).max() < 1e-12
    assert ((gradient - gradient.mT).abs().amax((-1, -2)) / size).max() < 1e-12


@pytest.mark.parametrize("spacing_m", [0.01, 0.004])
def test_its_prior_means_the_same_at_every_spacing(spacing_m):
    """Covariances of the field between places, of independent amplitudes with rms 1, against those of charges four times denser."""
    half_m = (0.02, 0.02, 0.02)
    points_m = torch.tensor([[0.0, 0.0, 0.0], [0.008, 0.0, 0.0], [0.008, 0.008, 0.008]]).double()
    coarse, fine = (
        columns(half_m, intervals(half_m, 0.0, step_m), points_m) for step_m in (spacing_m, 0.002)
    )
    assert float((coarse[:3] ** 2).sum()) == pytest.approx(1.0)
    torch.testing.assert_close(coarse @ coarse.T, fine @ fine.T, rtol=0.25, atol=0.06)


def test_a_sum_of_charges_other_than_zero_need_not_make_a_field_inside():
    """As on a conductor; so nothing is lost or gained by asking for a sum of zero."""
    n = (16, 16, 16)
    design = columns((1.0, 1.0, 1.0), n, 0.5 * inside(200) / 0.03)
    sums = torch.ones(1, design.shape[1], dtype=torch.float64)
    wanted = torch.zeros(len(design) + 1, 1, dtype=torch.float64)
    wanted[-1] = float(design.shape[1])
    amplitudes = torch.linalg.lstsq(torch.cat((design, sums)), wanted, driver="gelsd").solution
    assert float(amplitudes.mean()) == pytest.approx(1.0, rel=1e-3)
    alone = design.square().sum(0).sqrt().mean() * amplitudes.abs().mean() * len(amplitudes)
    assert float((design @ amplitudes).norm()) < 1e-3 * float(alone)


def test_batches_dtype_and_places_are_kept():
    amplitudes = torch.randn(4, n_charges(N), generator=torch.Generator().manual_seed(2))
    together = charged_box_field(inside(6).float(), HALF_M, N, amplitudes)
    assert together.dtype == torch.float32
    one_by_one = torch.stack([charged_box_field(inside(6).float(), HALF_M, N, a) for a in amplitudes])
    torch.testing.assert_close(together, one_by_one)
    assert len(charge_places(HALF_M, N).unique(dim=0)) == n_charges(N)


def test_a_multipole_of_the_first_degree_is_a_dipole_and_each_degree_has_rms_1_a_gap_away():
    place_m, gap_m = torch.tensor([[0.05, -0.02, 0.01]]).double(), torch.tensor([0.02]).double()
    generator = torch.Generator().manual_seed(1)
    direction = torch.randn(4000, 3, generator=generator, dtype=torch.float64)
    around_m = place_m + gap_m * direction / direction.norm(dim=-1, keepdim=True)
    each_T = multipole_field(around_m, place_m, gap_m, torch.eye(sum(SIZES), dtype=torch.float64))
    for part in each_T.square().sum(-1).mean(-1).split(SIZES):
        assert float(part.sum()) == pytest.approx(1.0, rel=0.05)
    points_m = inside(30)
    moments = np.eye(3)
    dipoles_T = np.stack(
        [magpylib.misc.Dipole(position=place_m[0].numpy(), moment=m).getB(points_m.numpy()) for m in moments]
    )
    own_T = multipole_field(points_m, place_m, gap_m, torch.eye(sum(SIZES), dtype=torch.float64)[:3])
    columns_T = own_T.flatten(1).T.numpy()
    left = [np.linalg.lstsq(columns_T, d.ravel(), rcond=None)[1][0] / (d**2).sum() for d in dipoles_T]
    assert max(left) < 1e-24


def test_two_multipoles_add_and_rows_stay_apart():
    places_m, gaps_m = (
        torch.tensor([[0.05, 0.0, 0.0], [0.0, -0.04, 0.0]]).double(),
        torch.tensor([0.03, 0.025]),
    )
    amplitudes = torch.randn(2, 16, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    both_T = multipole_field(inside(5), places_m, gaps_m, amplitudes)
    one_T, other_T = (
        multipole_field(inside(5), places_m[i : i + 1], gaps_m[i : i + 1], amplitudes[:, 8 * i : 8 * i + 8])
        for i in range(2)
    )
    torch.testing.assert_close(both_T, one_T + other_T)
    torch.testing.assert_close(multipole_field(inside(5), places_m, gaps_m, amplitudes[1]), both_T[1])

"""NumPy stands for torch: the same names give the same numbers in the same formats, and every cause predicts the same readings."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from estimator import numpy_tensors
from tests.every_cause import predictions

ROOT = Path(__file__).parents[2]
RANDOM = np.random.default_rng(0)
CUBE, SQUARES = RANDOM.standard_normal((2, 3, 4)), RANDOM.standard_normal((5, 3, 3))
NUMBERS = np.array([3, 1, 2, 1, 0])

CALLS = {
    "kinds": lambda t: [
        t.arange(3) * 1.5,
        t.arange(3) * t.tensor(1.5, dtype=t.float64),
        t.arange(3) / 2,
        t.ones(2) * t.tensor(1.5, dtype=t.float64),
        t.ones(2) * t.ones(2, dtype=t.int64),
        t.ones(2) + t.ones(2, dtype=t.float64),
        t.tensor([1.0, 2.0]),
        t.tensor([1, 2]),
        t.tensor(True),
        t.where(t.tensor([True, False]), 1.0, t.ones(2, dtype=t.float64)),
        t.where(t.tensor([True, False]), 1.0, 0.0),
        t.tensor([True, True]).sum(),
        t.full((2,), t.nan),
        t.linspace(0.0, 1.0, 3),
        2.0 - t.arange(2),
        2 / t.arange(1, 3),
        1.0 / t.ones(2, dtype=t.float64),
        t.zeros_like(t.arange(2), dtype=t.bool),
    ],
    "form": lambda t: [
        *(c := t.from_numpy(CUBE)).unbind(-1),
        c.mT,
        c.flatten(1),
        c.flatten(-2, -1),
        c.flatten(0, 1).unflatten(0, (2, 3)),
        c[None].expand(5, -1, -1, -1),
        c.movedim(0, -1),
        *c.split(2, dim=-1),
        *c.split((1, 3), dim=-1),
        *c.tensor_split(2, dim=1),
        *c.chunk(2, dim=1),
        c[0].repeat(2, 1),
        c.repeat_interleave(2, dim=0),
        c.flip(-1),
        c[0, 0].roll(1),
        c.diff(dim=-1),
        c.diff(dim=1, prepend=c[:, :1]),
        *t.broadcast_tensors(c[0, 0], c),
        t.stack([c, c], -1),
        t.cat([c, c], dim=1),
        t.diag_embed(c, offset=-1),
        t.diag_embed(c),
        t.nn.functional.pad(c, (1, 2, 0, 1)),
        *t.meshgrid(c[0, 0], c[0, :, 0], indexing="ij"),
        t.cartesian_prod(c[0, 0], c[0, :, 0]),
        t.from_numpy(SQUARES).diagonal(dim1=-2, dim2=-1),
        c.new_tensor(3),
        c.new_zeros(2, 1),
        c.reshape(-1, 2),
    ],
    "places": lambda t: [
        t.from_numpy(NUMBERS).sort().values,
        t.argsort(t.from_numpy(NUMBERS), stable=True),
        t.from_numpy(NUMBERS).unique(),
        *t.unique(t.from_numpy(NUMBERS), return_inverse=True),
        *t.unique(t.from_numpy(NUMBERS)[:, None] % 2, dim=0, return_inverse=True),
        (t.from_numpy(NUMBERS) == 1).nonzero(),
        t.from_numpy(CUBE).max(),
        *t.from_numpy(CUBE).max(-1),
        *t.from_numpy(CUBE).min(0),
        t.from_numpy(CUBE).amax((0, 1)),
        t.from_numpy(CUBE).argmax(-1),
        t.topk(t.from_numpy(CUBE)[0, 0], 2, largest=False).indices,
        t.from_numpy(CUBE).index_copy(-2, t.tensor([2, 0]), t.zeros(2, 2, 4, dtype=t.float64)),
        t.gather(t.from_numpy(CUBE), 0, t.tensor([[[1, 0]]])),
        t.from_numpy(CUBE).take_along_dim(t.tensor([[[1]], [[0]]]), -2),
        t.from_numpy(CUBE).index_select(-1, t.tensor([3, 0])),
        t.searchsorted(t.tensor([1.0, 2.0, 3.0]), t.tensor([2.0, 9.0]), right=True),
        t.cummax(t.from_numpy(NUMBERS), dim=0).values,
        t.from_numpy(np.where(NUMBERS > 0.0, NUMBERS, np.nan)).nanmedian(dim=0).values,
        t.isin(t.from_numpy(NUMBERS), t.tensor([1, 9])),
        t.full((3,), 9).scatter_reduce(0, t.tensor([0, 0, 2]), t.tensor([5, 4, 7]), "amin"),
        t.from_numpy(CUBE).masked_fill(t.from_numpy(CUBE) > 0.0, t.nan).nan_to_num(),
        t.from_numpy(NUMBERS)[t.from_numpy(NUMBERS) > 1],
        t.bincount(t.from_numpy(NUMBERS)),
    ],
    "arithmetic": lambda t: [
        *(
            (c := t.from_numpy(CUBE)) + 1,
            1 - c,
            c * c,
            c / 3,
            c**2,
            c**3,
            2.0**c,
            c % 0.3,
            -c,
            abs(c),
            ~(c > 0.0),
        ),
        *(c.clamp(min=0.0), c.clamp(max=c[0]), c.round(decimals=2), c.sign(), c.square(), c.norm(dim=-1)),
        *(c.mean(0), c.sum((-1, 0)), c.std(), c.median(), c.cumsum(1), (c > 0.0).any(-1)),
        *(c.abs().sqrt(), c.abs().rsqrt(), c.sin(), c.exp(), c.abs().log(), c.asinh(), t.atan2(c, c.cos())),
        *(t.maximum(c, -c), t.minimum(c[0], c), t.logaddexp(c, c), t.lerp(c, -c, 0.3), t.lerp(c, -c, 0.7)),
        *(t.addcmul(c, c, c, value=-1.0), t.add(c, c, alpha=2.0), c @ c.mT, t.einsum("bij,bij->b", c, c)),
        *(t.equal(c, c), t.allclose(c, c + 1.0), bool((c > 9.0).any()), float(c.max()), f"{c.max():.3g}"),
        t.linalg.cross(c[..., :3], -c[..., 1:]),
        t.nn.functional.normalize(c, dim=-1),
        t.nn.functional.one_hot(t.from_numpy(NUMBERS), 4),
        t.linalg.inv(s := t.from_numpy(SQUARES)),
        t.linalg.eigh(s + s.mT)[0],
        t.linalg.svdvals(s),
        t.linalg.svd(s, full_matrices=False)[1],
        t.linalg.solve_ex(s, s[..., :1])[0],
        t.linalg.lstsq(c[0].mT, c[0, 0][:, None], driver="gelsd").solution,
    ],
}


@pytest.mark.parametrize("call", CALLS)
def test_the_same_call_gives_the_same_numbers_in_the_same_format(call):
    for n, (theirs, ours) in enumerate(zip(CALLS[call](torch), CALLS[call](numpy_tensors), strict=True)):
        if not isinstance(theirs, torch.Tensor):
            assert theirs == ours, n
            continue
        assert theirs.numpy().dtype == ours.dtype, n
        np.testing.assert_allclose(ours.numpy(), theirs.numpy(), rtol=1e-12, atol=1e-14, err_msg=str(n))


def test_arrays_are_changed_in_place():
    def changed(t: Any) -> list[Any]:
        whole = t.zeros(2, 3)
        part = whole[0]
        part += 1.0
        whole[:, 2] = t.tensor([5.0, 6.0])
        mask = t.tensor([True, False])
        mask |= ~mask
        return [whole.tolist(), mask.tolist()]

    assert changed(numpy_tensors) == changed(torch)


def test_derivatives_by_complex_steps_are_those_of_torch():
    def function(t: Any, x: Any) -> Any:
        return t.stack(
            (x[0].sin() * x[1] ** 2, (x[1].abs() + x[0]).sqrt(), t.where(x[0] > 0.0, x[1], 0.0 * x[1]))
        )

    at = [0.3, -0.7]
    _, slopes = numpy_tensors.jacobian_by_complex_steps(
        lambda x: function(numpy_tensors, x),
        numpy_tensors.tensor(at, numpy_tensors.float64),
        numpy_tensors.eye(2),
    )
    expected = torch.func.jacfwd(lambda x: function(torch, x))(torch.tensor(at, dtype=torch.float64))
    np.testing.assert_allclose(slopes.numpy(), expected.numpy(), rtol=1e-14)


def test_what_would_drop_a_derivative_is_an_error():
    t = numpy_tensors

    def drops(x: Any) -> Any:
        whole = t.zeros(2, dtype=t.float64)
        whole[0] = x[0]
        return whole

    for function in (drops, lambda x: x.double(), lambda x: t.linalg.svdvals(x[None])):
        with pytest.raises((TypeError, np.exceptions.ComplexWarning)):
            t.jacobian_by_complex_steps(function, t.ones(2, dtype=t.float64), t.eye(2))


@pytest.mark.whole
def test_every_cause_predicts_on_numpy_what_it_predicts_with_torch(tmp_path):
    file = tmp_path / "on_numpy.npz"
    call = [sys.executable, "-m", "tests.every_cause", file]
    subprocess.run(call, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True)
    with np.load(file) as on_numpy:
        with_torch = predictions()
        assert set(on_numpy) == set(with_torch)
        for cause, expected_T in with_torch.items():
            largest_T = np.nanmax(np.abs(expected_T))
            np.testing.assert_allclose(
                on_numpy[cause], expected_T, rtol=0, atol=1e-11 * largest_T, err_msg=cause
            )

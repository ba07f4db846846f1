"""Systems of positive definite matrices, also of many rows with several threads."""

from __future__ import annotations

import mpmath
import torch
from torch.testing import assert_close

from estimator.inference.positive_definite import inverse, log_determinant, lower_factor, solve, solve_each
from tests.program import PYTHON, finished

SEVERAL_THREADS = """
import torch
from estimator.inference.positive_definite import inverse, log_determinant, solve

torch.set_num_threads(2)
random = torch.Generator().manual_seed(0)
root = torch.randn(60, 200, 200, generator=random, dtype=torch.float64)
matrix, right = root @ root.mT / 200.0 + torch.eye(200), torch.ones(60, 200, dtype=torch.float64)
missed = (matrix @ solve(matrix, right)[..., None])[..., 0] - right
assert missed.abs().max() < 1e-10, missed.abs().max()
assert (matrix @ inverse(matrix) - torch.eye(200)).abs().max() < 1e-10
assert torch.isfinite(log_determinant(matrix)).all()
"""


def matrices() -> torch.Tensor:
    """Three, whose units differ by twelve powers of ten."""
    random = torch.Generator().manual_seed(2)
    root = torch.randn(3, 5, 9, generator=random, dtype=torch.float64)
    unit = torch.tensor([1e-6, 1.0, 3.0, 1e3, 1e6], dtype=torch.float64)
    return root @ root.mT * unit[:, None] * unit


def test_solutions_inverses_and_determinants_are_those_of_sixty_digits():
    matrix, right = matrices(), torch.arange(1.0, 16.0, dtype=torch.float64).reshape(3, 5)
    with mpmath.workdps(60):
        exact = [mpmath.matrix(each.tolist()) for each in matrix]
        inverses = torch.tensor([(each**-1).tolist() for each in exact], dtype=torch.float64)
        log_determinants = [float(mpmath.log(mpmath.det(each))) for each in exact]
    ours = inverse(matrix)
    assert_close(ours, inverses, rtol=1e-11, atol=0.0)
    assert torch.equal(ours, ours.mT)
    assert_close(solve_each(matrix, torch.eye(5).to(matrix).expand(3, 5, 5)), inverses, rtol=1e-9, atol=0.0)
    assert_close(solve(matrix, right), (inverses @ right[..., None])[..., 0], rtol=1e-9, atol=0.0)
    assert_close(log_determinant(matrix), matrix.new_tensor(log_determinants), rtol=1e-12, atol=0.0)


def test_what_rounding_has_made_indefinite_is_solved_all_the_same():
    angle = torch.tensor([0.3, 0.3, 1.1], dtype=torch.float64)
    column = torch.stack((angle.cos(), angle.sin()), dim=-1)
    matrix = column @ column.mT - 1e-9 * torch.eye(3, dtype=torch.float64)  # of rank two, less a little
    right = torch.ones(3, dtype=torch.float64)
    both = torch.stack((matrix, torch.eye(3, dtype=torch.float64)))
    assert_close(both[0] @ solve(both, right.expand(2, 3))[0], right, rtol=0.0, atol=1e-4)
    assert_close(inverse(both)[0] @ matrix, torch.eye(3, dtype=torch.float64), rtol=0.0, atol=1e-4)
    assert_close(
        log_determinant(both)[0], torch.linalg.slogdet(matrix).logabsdet.clone(), rtol=1e-5, atol=0.0
    )


def test_a_matrix_without_values_has_none_and_leaves_the_others_theirs():
    """Weights of tuples of counts give such a fit none (`lattice`)."""
    unit = torch.eye(3, dtype=torch.float64)
    both = torch.stack((torch.full((3, 3), torch.nan, dtype=torch.float64), 4.0 * unit))
    assert log_determinant(both).isnan().tolist() == [True, False]
    assert_close(log_determinant(both)[1], log_determinant(4.0 * unit), rtol=1e-15, atol=0.0)
    assert inverse(both)[0].isnan().all()
    assert_close(inverse(both)[1], 0.25 * unit, rtol=0.0, atol=1e-15)
    solution = solve(both, torch.ones(2, 3, dtype=torch.float64))
    assert solution[0].isnan().all()
    assert_close(solution[1], torch.full_like(solution[1], 0.25), rtol=1e-12, atol=0.0)


def test_a_factor_of_a_covariance_that_rounding_has_made_indefinite_is_that_of_its_neighbour():
    generator = torch.Generator().manual_seed(1)
    root = torch.randn(6, 3, generator=generator, dtype=torch.float64)
    sizes = torch.tensor([1e-6, 1.0, 1e3, 1e-3, 1.0, 10.0], dtype=torch.float64)
    singular = sizes[:, None] * (root @ root.mT) * sizes  # of rank three
    singular -= 1e-15 * torch.diag(singular.diagonal())
    good = torch.diag(sizes**2)
    factors = lower_factor(torch.stack((singular, good)))
    assert_close(factors[1], torch.diag(sizes), rtol=1e-15, atol=0.0)
    assert (factors[0].triu(1) == 0.0).all()
    assert (factors[0].diagonal() > 0.0).all()
    scale = sizes[:, None] * sizes
    assert_close(factors[0] @ factors[0].mT / scale, singular / scale, rtol=0.0, atol=1e-13)


def test_batches_of_many_rows_are_solved_with_several_threads():
    """The LU of torch fails here, or never ends (pytorch issue 141358)."""
    ran = finished(PYTHON, "-c", SEVERAL_THREADS, timeout=120)
    assert ran.returncode == 0, ran.stderr[-500:]
    assert "MKL" not in ran.stdout + ran.stderr

"""Solutions of systems of equations that may have none, or many."""

from __future__ import annotations

from jaxtyping import Float

from estimator.tensors import Tensor, torch


def least_squares(
    matrix: Float[Tensor, "*batch row column"], right: Float[Tensor, "*batch row"]
) -> Float[Tensor, "*batch column"]:
    """The shortest vector that comes nearest to solving a system.

    LAPACK's `gelsd` on the processor: PyTorch hands its default, `gelsy`, memory that is not set, so that solutions differ from run to run
    and some are wrong (https://github.com/pytorch/pytorch/issues/187411). Other devices know full ranks only.

    Examples:
        >>> ones = torch.ones(2, 2, dtype=torch.float64)
        >>> least_squares(ones, torch.tensor([1.0, 3.0], dtype=torch.float64)).round(decimals=9).tolist()
        [1.0, 1.0]
    """
    driver = "gelsd" if matrix.device.type == "cpu" else None
    solution: Tensor = torch.linalg.lstsq(matrix, right[..., None], driver=driver).solution
    return solution[..., 0]

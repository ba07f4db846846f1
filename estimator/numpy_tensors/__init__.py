"""The part of torch that predictions, simulations and files use, on NumPy: names, meaning and number formats are those of torch.

`estimator.tensors` lets this module stand for torch in commands that take no derivative, which then do without its second and 200 MB.
Numbers lie on the processor and carry no derivatives. Whoever asks for something that is not here gets an `AttributeError` and is
noted in `lacking`: the command then starts again with torch (`estimator.cli.without_torch`).
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from estimator.numpy_tensors import arithmetic
from estimator.numpy_tensors.arithmetic import dims, float32, float64, int64, own, pair
from estimator.numpy_tensors.tensor import Tensor, lacking

SMALL_STEP = 1e-100  # nothing is subtracted, so that it may be as small as numbers are

dtype, bool, device = np.dtype, arithmetic.bool, arithmetic.device
nan, inf, pi = math.nan, math.inf, math.pi
contiguous_format = None


def __getattr__(name: str) -> Any:
    """A method of tensors as a function."""
    if hasattr(Tensor, name) and not name.startswith("__"):
        return lambda first, *more, **named: getattr(as_tensor(first), name)(*more, **named)
    lacking.append(name)
    raise AttributeError(f"NumPy stands for torch, without torch.{name}")


# Tensors that are made.


def tensor(data: Any, dtype: Any = None, device: object = None) -> Tensor:
    array = np.array(data.array if isinstance(data, Tensor) else data)
    if dtype is None and array.dtype == float64 and not _states_format(data):
        dtype = float32
    return Tensor(array if dtype is None else array.astype(dtype))


def _states_format(data: Any) -> object:
    """Whether numbers come with a format, which those of Python do not."""
    while isinstance(data, list | tuple):
        if not data:
            return False
        data = data[0]
    return isinstance(data, Tensor | np.ndarray | np.generic)


def as_tensor(data: Any, dtype: Any = None, device: object = None) -> Tensor:
    if isinstance(data, Tensor | np.ndarray):
        return Tensor(own(data)).to(dtype)
    return tensor(data, dtype)


def from_numpy(array: np.ndarray) -> Tensor:
    return Tensor(array)


def _filled(function: Callable[..., Any]) -> tuple[Callable[..., Tensor], Callable[..., Tensor]]:
    """Functions that make a tensor of a shape, and one of the shape of another."""

    def made(*sizes: Any, dtype: Any = float32, device: object = None) -> Tensor:
        return Tensor(function(dims(sizes), dtype))

    def like(other: Tensor, dtype: Any = None, device: object = None) -> Tensor:
        return Tensor(function(other.shape, dtype or other.dtype))

    return made, like


zeros, zeros_like = empty, empty_like = _filled(np.zeros)
ones, ones_like = _filled(np.ones)


def full(size: Any, value: Any, dtype: Any = None, device: object = None) -> Tensor:
    return Tensor(np.full(size, own(value), tensor(value).dtype if dtype is None else dtype))


def eye(n: int, dtype: Any = float32, device: object = None) -> Tensor:
    return Tensor(np.eye(n, dtype=dtype))


def arange(*ends: Any, dtype: Any = None, device: object = None) -> Tensor:
    is_whole = not any(isinstance(end, float) for end in ends)
    return Tensor(np.arange(*map(own, ends), dtype=dtype or (int64 if is_whole else float32)))


def linspace(first: Any, last: Any, n: int, dtype: Any = float32, device: object = None) -> Tensor:
    return Tensor(np.linspace(own(first), own(last), n, dtype=dtype))


def full_like(like: Tensor, value: Any, dtype: Any = None) -> Tensor:
    return Tensor(np.full(like.shape, own(value), dtype or like.dtype))


# Several tensors together.


def _joined(function: Callable[..., Any], tensors: Any, dim: int) -> Tensor:
    arrays = [each.array for each in tensors]
    return Tensor(function(arrays, axis=dim))


def stack(tensors: Any, dim: int = 0) -> Tensor:
    return _joined(np.stack, tensors, dim)


def cat(tensors: Any, dim: int = 0) -> Tensor:
    return _joined(np.concatenate, tensors, dim)


def where(condition: Tensor, first: Any, second: Any) -> Tensor:
    if not isinstance(first, Tensor) and not isinstance(second, Tensor):
        return Tensor(np.where(condition.array, tensor(first).array, tensor(second).array))
    return Tensor(np.where(condition.array, *pair(first, second)))


def broadcast_tensors(*tensors: Tensor) -> tuple[Tensor, ...]:
    shape = np.broadcast_shapes(*(each.array.shape for each in tensors))
    return tuple(each.expand(*shape) for each in tensors)


def meshgrid(*axes: Tensor, indexing: Any) -> tuple[Tensor, ...]:
    return tuple(map(Tensor, np.meshgrid(*(axis.array for axis in axes), indexing=indexing)))


def cartesian_prod(*axes: Tensor) -> Tensor:
    grids = np.meshgrid(*(axis.array for axis in axes), indexing="ij")
    return Tensor(np.stack([grid.reshape(-1) for grid in grids], axis=-1))


def equal(first: Tensor, second: Tensor) -> object:
    return np.array_equal(first.array, second.array)


def allclose(first: Tensor, second: Tensor, rtol: float = 1e-5, atol: float = 1e-8) -> object:
    return np.allclose(first.array, second.array, rtol, atol)


def einsum(rule: str, *tensors: Tensor) -> Tensor:
    return Tensor(np.einsum(rule, *(each.array for each in tensors)))


def add(first: Tensor, second: Any, alpha: float = 1.0) -> Any:
    return first + (second if alpha == 1.0 else alpha * second)


def addcmul(first: Tensor, second: Tensor, third: Tensor, value: float = 1.0) -> Any:
    return first + (second * third if value == 1.0 else value * second * third)


def lerp(first: Tensor, second: Tensor, weight: float) -> Any:
    return first + weight * (second - first) if weight < 0.5 else second - (second - first) * (1.0 - weight)


def diag(diagonal: Tensor) -> Tensor:
    return Tensor(np.diag(diagonal.array))


def diag_embed(diagonal: Tensor, offset: int = 0) -> Tensor:
    n = diagonal.array.shape[-1] + abs(offset)
    whole = np.zeros((*diagonal.array.shape[:-1], n, n), diagonal.dtype)
    rows = np.arange(diagonal.array.shape[-1])
    whole[..., rows + max(-offset, 0), rows + max(offset, 0)] = diagonal.array
    return Tensor(whole)


def _pad(whole: Tensor, sizes: Sequence[int]) -> Tensor:
    by_axis = [(sizes[i], sizes[i + 1]) for i in range(0, len(sizes), 2)][::-1]
    return Tensor(np.pad(whole.array, [(0, 0)] * (whole.ndim - len(by_axis)) + by_axis))


def _one_hot(numbers: Tensor, n: int) -> Tensor:
    return Tensor((numbers.array[..., None] == np.arange(n)).astype(int64))


def _normalize(vectors: Tensor, dim: int = 1, eps: float = 1e-12) -> Any:
    return vectors / vectors.norm(dim, keepdim=True).clamp(min=eps)


def _cross(first: Tensor, second: Tensor, dim: int = -1) -> Tensor:
    x, y = (np.moveaxis(each, dim, 0) for each in np.broadcast_arrays(first.array, second.array))
    turned = [x[(i + 1) % 3] * y[(i + 2) % 3] - x[(i + 2) % 3] * y[(i + 1) % 3] for i in range(3)]
    return Tensor(np.moveaxis(np.stack(turned), 0, dim))


def _of_real(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of matrices of real numbers: those of LAPACK that take complex ones conjugate them, which no complex step goes through."""

    def apply(*matrices: Tensor, **named: Any) -> Any:
        if any(matrix.dtype.kind == "c" for matrix in matrices):
            raise TypeError("a complex step goes through no decomposition of a matrix")
        result = function(*(matrix.array for matrix in matrices), **named)
        return type(result)(*map(Tensor, result)) if isinstance(result, tuple) else Tensor(result)

    return apply


class _Solution(NamedTuple):
    solution: Any
    info: Any = 0


linalg = SimpleNamespace(
    cross=_cross,
    eigh=_of_real(np.linalg.eigh),
    svd=_of_real(np.linalg.svd),
    svdvals=_of_real(np.linalg.svdvals),
    inv=_of_real(np.linalg.inv),
    pinv=_of_real(np.linalg.pinv),
    lstsq=_of_real(lambda matrix, right, driver: _Solution(np.linalg.lstsq(matrix, right)[0])),
    solve_ex=_of_real(lambda matrix, right: _Solution(np.linalg.solve(matrix, right))),
)
nn = SimpleNamespace(functional=SimpleNamespace(pad=_pad, one_hot=_one_hot, normalize=_normalize))

# Derivatives, which nothing carries, and threads, of which there is one.


@contextmanager
def no_grad() -> Iterator[None]:
    yield


@contextmanager
def set_grad_enabled(_: object) -> Iterator[None]:
    yield


def is_grad_enabled() -> Any:
    return False


def get_num_threads() -> int:
    return int(os.environ.get("OMP_NUM_THREADS", "1"))


def set_num_threads(_: int) -> None:
    pass


_C = SimpleNamespace(_functorch=SimpleNamespace(is_functorch_wrapped_tensor=lambda _: False))
autograd = SimpleNamespace(forward_ad=SimpleNamespace(unpack_dual=lambda _: SimpleNamespace(tangent=None)))
compiler = SimpleNamespace(is_compiling=lambda: False)


def jacobian_by_complex_steps(
    function: Callable[[Tensor], Tensor], point: Tensor, directions: Tensor
) -> tuple[Tensor, Tensor]:
    """Values of a function and their derivatives along directions, exact to rounding, from values a tiny imaginary step away.

    Args:
        function: Analytic where it is asked. What drops an imaginary part, or has none, is an error.
        point, directions: As in `estimator.derivatives.value_and_jacobian`.
    References: W. Squire and G. Trapp, SIAM Review 40, 110 (1998).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        steps = point.array + 1j * SMALL_STEP * directions.array.astype(float64)
        slopes = [function(Tensor(at)).array.imag / SMALL_STEP for at in steps]
    value = function(point)
    return value, Tensor(np.stack(slopes, axis=-1) if slopes else np.zeros((*value.shape, 0)))

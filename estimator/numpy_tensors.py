"""The part of torch that predictions, simulations and files use, on NumPy: names, meaning and number formats are those of torch.

`estimator.tensors` lets this module stand for torch in commands that take no derivative, which then do without its second and 200 MB.
Numbers lie on the processor and carry no derivatives. Whoever asks for something that is not here gets an `AttributeError` and is
noted in `lacking`: the command then starts again with torch (`estimator.cli.without_torch`).
"""

from __future__ import annotations

import math
import operator
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

lacking: list[str] = []
SMALL_STEP = 1e-100  # nothing is subtracted, so that it may be as small as numbers are

float64, float32 = np.dtype(np.float64), np.dtype(np.float32)
int64 = np.dtype(np.int64)
bool = np.dtype(np.bool_)
dtype = np.dtype
nan, inf, pi = math.nan, math.inf, math.pi
contiguous_format = None
Whole: TypeAlias = int  # by names that no method of tensors has
Real: TypeAlias = float
EVERY_DIM = None


@dataclass(frozen=True)
class device:
    """The only place where numbers lie."""

    type: str = "cpu"


class Size(tuple[int, ...]):
    """Shape of a tensor."""

    def numel(self) -> int:
        """Product of the lengths."""
        return math.prod(self)

    def __getitem__(self, key: Any) -> Any:
        part = super().__getitem__(key)
        return Size(part) if isinstance(key, slice) else part


class WithIndices(NamedTuple):
    """Values found along an axis, and where they stand."""

    values: Tensor
    indices: Tensor


def _own(value: Any) -> Any:
    """What NumPy takes for a tensor, or for anything with tensors in it."""
    if isinstance(value, Tensor):
        return value.array
    return tuple(map(_own, value)) if isinstance(value, tuple) else value


def _dims(sizes: tuple[Any, ...]) -> tuple[int, ...]:
    """Lengths that were given one by one or in one sequence."""
    whole = sizes[0] if len(sizes) == 1 and isinstance(sizes[0], Sequence) else sizes
    return tuple(int(size) for size in whole)


def _real(array: np.ndarray) -> np.ndarray:
    """Whole numbers as what a function with fractions makes of them."""
    return array if array.dtype.kind in "fc" else array.astype(float32)


def _pair(first: Any, second: Any) -> tuple[Any, Any]:
    """Operands in the format in which torch combines them: numbers without an axis, and those of Python, give way to arrays."""
    x, y = _own(first), _own(second)
    if getattr(x, "dtype", None) is getattr(y, "dtype", first):
        return x, y
    if not isinstance(x, np.ndarray):
        y, x = _pair(second, first)
    elif not isinstance(y, np.ndarray):
        return (_real(x) if isinstance(y, float) else x), y
    elif x.dtype != y.dtype:
        if x.dtype.kind == y.dtype.kind:
            alone = (x.ndim == 0) - (y.ndim == 0)
            wanted = np.result_type(x, y) if alone == 0 else (y if alone > 0 else x).dtype
        else:
            ranks = ["biufc".index(each.dtype.kind) for each in (x, y)]
            wanted = (x if ranks[0] > ranks[1] else y).dtype
        x, y = x.astype(wanted, copy=False), y.astype(wanted, copy=False)
    return x, y


def _forward(function: Callable[..., Any]) -> Callable[[Any, Any], Any]:
    def apply(self: Any, other: Any) -> Any:
        return Tensor(function(*_pair(self, other)))

    return apply


def _backward(function: Callable[..., Any]) -> Callable[[Any, Any], Any]:
    def apply(self: Any, other: Any) -> Any:
        y, x = _pair(self, other)
        return Tensor(function(x, y))

    return apply


def _in_place(function: Callable[..., Any]) -> Callable[[Any, Any], Any]:
    def apply(self: Any, other: Any) -> Any:
        self.array[...] = function(*_pair(self, other))
        return self

    return apply


def _quotient(x: Any, y: Any) -> Any:
    if (x.dtype if isinstance(x, np.ndarray) else y.dtype).kind not in "fc":
        x, y = np.asarray(x, float32), np.asarray(y, float32)
    return np.true_divide(x, y)


def _size(x: np.ndarray) -> Any:
    """|x|, which a complex step goes through (`jacobian_by_complex_steps`)."""
    return np.where(x.real < 0.0, -x, x) if x.dtype.kind == "c" else np.abs(x)


def _sign(x: np.ndarray) -> Any:
    """1, 0 or -1, which a complex step does not change."""
    return np.sign(x.real)


def _elementwise(function: Callable[..., Any], is_real: object = True) -> Callable[[Any], Any]:
    def apply(self: Any) -> Any:
        return Tensor(function(_real(self.array) if is_real else self.array))

    return apply


def _reduced(function: Callable[..., Any]) -> Callable[..., Any]:
    def apply(self: Any, dim: Any = EVERY_DIM, keepdim: object = False) -> Any:
        axis = tuple(dim) if isinstance(dim, list) else dim
        return Tensor(function(self.array, axis=axis, keepdims=keepdim))

    return apply


def _extreme(
    each: Callable[..., Any], best: Callable[..., Any], where: Callable[..., Any]
) -> Callable[..., Any]:
    def apply(self: Any, dim: Any = EVERY_DIM, keepdim: object = False) -> Any:
        if dim is EVERY_DIM:
            return Tensor(best(self.array))
        if isinstance(dim, Tensor):
            return Tensor(each(*_pair(self, dim)))
        places = where(self.array, axis=dim, keepdims=True)
        values = np.take_along_axis(self.array, places, dim)
        both = (values, places) if keepdim else (values.squeeze(dim), places.squeeze(dim))
        return WithIndices(*map(Tensor, both))

    return apply


class Tensor:
    """Numbers, whose operations are those of `torch.Tensor`."""

    __slots__ = ("array",)
    __array_priority__ = 1000.0  # or NumPy would take its own operators for them
    requires_grad, is_cuda, device = False, False, device()

    def __init__(self, array: Any) -> None:
        self.array = np.asarray(array)

    def __getattr__(self, name: str) -> Any:
        lacking.append(name)
        raise AttributeError(f"numbers on NumPy have no {name}")

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.array(self.array, dtype=dtype, copy=copy)

    # Numbers of Python.

    def __len__(self) -> Whole:
        return len(self.array)

    def __iter__(self) -> Iterator[Tensor]:
        return map(Tensor, self.array)

    def __bool__(self) -> Any:
        return self.array.__bool__()

    def __float__(self) -> Real:
        return float(self.array.reshape(()))

    def __int__(self) -> Whole:
        return int(self.array.reshape(()))

    def __index__(self) -> Whole:
        return int(operator.index(self.array.reshape(())[()]))

    def __format__(self, words: str) -> str:
        return format(self.item(), words) if self.array.ndim == 0 else repr(self)

    def __repr__(self) -> str:
        return f"tensor({self.array!r})"

    __hash__ = object.__hash__

    def item(self) -> Any:
        """The only number."""
        return self.array.item()

    def tolist(self) -> Any:
        """Numbers in lists."""
        return self.array.tolist()

    def numpy(self) -> np.ndarray:
        """The array itself."""
        return self.array

    # Form.

    @property
    def shape(self) -> Size:
        """Length of each axis."""
        return Size(self.array.shape)

    @property
    def dtype(self) -> Any:
        """Format of the numbers."""
        return self.array.dtype

    @property
    def ndim(self) -> Whole:
        """Number of axes."""
        return self.array.ndim

    @property
    def mT(self) -> Tensor:
        """With the last two axes exchanged."""
        return Tensor(np.swapaxes(self.array, -1, -2))

    @property
    def T(self) -> Tensor:
        """With all axes in the other order."""
        return Tensor(self.array.T)

    def dim(self) -> Whole:
        return self.array.ndim

    def numel(self) -> Whole:
        return self.array.size

    def is_floating_point(self) -> Any:
        return self.array.dtype.kind == "f"

    def __getitem__(self, key: Any) -> Tensor:
        return Tensor(self.array[_own(key)])

    def __setitem__(self, key: Any, value: Any) -> None:
        self.array[_own(key)] = _own(value)

    def itself(self, *_: object, **__: object) -> Tensor:
        """These numbers: they lie on the processor and carry no derivatives."""
        return self

    detach = cpu = itself

    def clone(self) -> Tensor:
        return Tensor(self.array.copy())

    def contiguous(self) -> Tensor:
        return Tensor(np.require(self.array, requirements=("C", "W")))

    def to(self, kind: Any = None, **more: Any) -> Tensor:
        kind = more.get("dtype", kind)
        kind = kind.dtype if isinstance(kind, Tensor) else kind
        is_format = isinstance(kind, np.dtype)
        return Tensor(self.array.astype(kind, copy=False)) if is_format else self

    def bool(self) -> Tensor:
        return self.to(bool)

    def double(self) -> Tensor:
        return self.to(float64)

    def long(self) -> Tensor:
        return self.to(int64)

    def new_tensor(self, data: Any, **_: object) -> Tensor:
        return tensor(data, dtype=self.dtype)

    def new_zeros(self, *sizes: Any) -> Tensor:
        return Tensor(np.zeros(_dims(sizes), self.dtype))

    def new_ones(self, *sizes: Any) -> Tensor:
        return Tensor(np.ones(_dims(sizes), self.dtype))

    def reshape(self, *sizes: Any) -> Tensor:
        return Tensor(self.array.reshape(_dims(sizes)))

    def expand(self, *sizes: Any) -> Tensor:
        sizes = _dims(sizes)
        own = (1,) * (len(sizes) - self.ndim) + self.array.shape
        wanted = tuple(n if size == -1 else size for size, n in zip(sizes, own, strict=True))
        return self if wanted == self.array.shape else Tensor(np.broadcast_to(self.array, wanted))

    def expand_as(self, other: Tensor) -> Tensor:
        return self.expand(*other.shape)

    def flatten(self, start: Whole = 0, end: Whole = -1) -> Tensor:
        shape = self.array.shape or (1,)
        start, end = start % len(shape), end % len(shape)
        return Tensor(
            self.array.reshape(*shape[:start], math.prod(shape[start : end + 1]), *shape[end + 1 :])
        )

    def unflatten(self, dim: Whole, sizes: Sequence[Whole]) -> Tensor:
        shape, dim = self.array.shape, dim % self.ndim
        return Tensor(self.array.reshape(*shape[:dim], *sizes, *shape[dim + 1 :]))

    def transpose(self, first: Whole, second: Whole) -> Tensor:
        return Tensor(np.swapaxes(self.array, first, second))

    def movedim(self, source: Whole, target: Whole) -> Tensor:
        return Tensor(np.moveaxis(self.array, source, target))

    def unbind(self, dim: Whole = 0) -> tuple[Tensor, ...]:
        return tuple(map(Tensor, np.moveaxis(self.array, dim, 0)))

    def split(self, sizes: Any, dim: Whole = 0) -> tuple[Tensor, ...]:
        length = self.array.shape[dim]
        ends = np.cumsum(sizes)[:-1] if isinstance(sizes, Sequence) else np.arange(sizes, length, sizes)
        return tuple(map(Tensor, np.split(self.array, ends, dim)))

    def tensor_split(self, n_parts: Whole, dim: Whole = 0) -> tuple[Tensor, ...]:
        return tuple(map(Tensor, np.array_split(self.array, n_parts, dim)))

    def chunk(self, n_parts: Whole, dim: Whole = 0) -> tuple[Tensor, ...]:
        return self.split(math.ceil(self.array.shape[dim] / n_parts), dim)

    def repeat(self, *times: Any) -> Tensor:
        return Tensor(np.tile(self.array, _dims(times)))

    def repeat_interleave(self, times: Any, dim: Any = EVERY_DIM) -> Tensor:
        return Tensor(np.repeat(self.array, _own(times), dim))

    def roll(self, by: Whole) -> Tensor:
        return Tensor(np.roll(self.array, by))

    def flip(self, *dims: Any) -> Tensor:
        return Tensor(np.flip(self.array, _dims(dims)))

    def diagonal(self, dim1: Whole = 0, dim2: Whole = 1) -> Tensor:
        return Tensor(np.diagonal(self.array, axis1=dim1, axis2=dim2))

    # Places.

    def nonzero(self) -> Tensor:
        return Tensor(np.argwhere(self.array))

    def index_copy(self, dim: Whole, rows: Tensor, source: Tensor) -> Tensor:
        whole = np.moveaxis(self.array.copy(), dim, 0)
        whole[rows.array] = np.moveaxis(source.array, dim, 0)
        return Tensor(np.moveaxis(whole, 0, dim))

    def index_select(self, dim: Whole, rows: Tensor) -> Tensor:
        return Tensor(np.take(self.array, rows.array, dim))

    def gather(self, dim: Whole, index: Tensor) -> Tensor:
        ends = tuple(
            slice(None) if i == dim % self.ndim else slice(n) for i, n in enumerate(index.array.shape)
        )
        return Tensor(np.take_along_axis(self.array[ends], index.array, dim))

    def take_along_dim(self, index: Tensor, dim: Whole) -> Tensor:
        return Tensor(np.take_along_axis(self.array, index.array, dim))

    def scatter_reduce(self, dim: Whole, index: Tensor, source: Tensor, how: str) -> Tensor:
        assert (dim, self.ndim) == (0, 1)
        result = self.array.copy()
        {"amin": np.minimum, "amax": np.maximum, "sum": np.add}[how].at(result, index.array, source.array)
        return Tensor(result)

    def masked_fill(self, mask: Tensor, value: Any) -> Tensor:
        return Tensor(np.where(mask.array, np.asarray(value, self.dtype), self.array))

    def where(self, condition: Any, other: Any) -> Tensor:
        return where(condition, self, other)

    def sort(self, dim: Whole = -1, descending: object = False, stable: object = False) -> WithIndices:
        order = self.argsort(dim, descending)
        return WithIndices(self.take_along_dim(order, dim), order)

    def argsort(self, dim: Whole = -1, descending: object = False, stable: object = False) -> Tensor:
        return Tensor(np.argsort(-self.array if descending else self.array, dim, kind="stable"))

    def topk(self, n: Whole, largest: object = True) -> WithIndices:
        order = self.argsort(descending=largest)[..., :n]
        return WithIndices(self.take_along_dim(order, -1), order)

    def unique(
        self, dim: Any = EVERY_DIM, return_inverse: object = False, return_counts: object = False
    ) -> Any:
        parts = np.unique(self.array, False, return_inverse, return_counts, axis=dim, equal_nan=False)  # type: ignore[call-overload]
        return tuple(map(Tensor, parts)) if isinstance(parts, tuple) else Tensor(parts)

    def bincount(self) -> Tensor:
        return Tensor(np.bincount(self.array))

    def searchsorted(self, values: Tensor, right: object = False) -> Tensor:
        return Tensor(np.searchsorted(self.array, values.array, "right" if right else "left"))

    def cummax(self, dim: Whole) -> Any:
        return SimpleNamespace(values=Tensor(np.maximum.accumulate(self.array, axis=dim)))

    def isin(self, others: Tensor) -> Tensor:
        return Tensor(np.isin(self.array, others.array))

    # Arithmetic.

    __add__, __radd__, __iadd__ = _forward(np.add), _backward(np.add), _in_place(np.add)
    __sub__, __rsub__, __isub__ = _forward(np.subtract), _backward(np.subtract), _in_place(np.subtract)
    __mul__, __rmul__, __imul__ = _forward(np.multiply), _backward(np.multiply), _in_place(np.multiply)
    __truediv__, __rtruediv__, __itruediv__ = _forward(_quotient), _backward(_quotient), _in_place(_quotient)
    __pow__, __rpow__ = _forward(operator.pow), _backward(operator.pow)
    __mod__, __floordiv__ = _forward(np.remainder), _forward(np.floor_divide)
    __matmul__, __rmatmul__ = _forward(np.matmul), _backward(np.matmul)
    __and__, __rand__, __iand__ = (
        _forward(np.bitwise_and),
        _backward(np.bitwise_and),
        _in_place(np.bitwise_and),
    )
    __or__, __ror__, __ior__ = _forward(np.bitwise_or), _backward(np.bitwise_or), _in_place(np.bitwise_or)
    __eq__, __ne__ = _forward(np.equal), _forward(np.not_equal)
    __lt__, __le__, __gt__, __ge__ = map(_forward, (np.less, np.less_equal, np.greater, np.greater_equal))
    minimum, maximum, atan2, logaddexp = map(_forward, (np.minimum, np.maximum, np.arctan2, np.logaddexp))
    __neg__, __invert__, __abs__ = (_elementwise(f, False) for f in (np.negative, np.invert, _size))
    abs, sign, floor = (_elementwise(f, False) for f in (_size, _sign, np.floor))
    square, isnan, isfinite, isinf = (
        _elementwise(f, False) for f in (np.square, np.isnan, np.isfinite, np.isinf)
    )
    sqrt, sin, cos, exp = (_elementwise(f) for f in (np.sqrt, np.sin, np.cos, np.exp))
    log, log1p, log2 = (_elementwise(f) for f in (np.log, np.log1p, np.log2))
    asinh, acos, deg2rad = (_elementwise(f) for f in (np.arcsinh, np.arccos, np.deg2rad))
    rsqrt = _elementwise(lambda x: 1.0 / np.sqrt(x))
    sum, mean = _reduced(np.sum), _reduced(np.mean)
    all, any, amin, amax = _reduced(np.all), _reduced(np.any), _reduced(np.min), _reduced(np.max)
    argmin, argmax = _reduced(np.argmin), _reduced(np.argmax)
    min = _extreme(np.minimum, np.min, np.argmin)
    max = _extreme(np.maximum, np.max, np.argmax)

    def std(self) -> Tensor:
        return Tensor(np.std(self.array, ddof=1))

    def median(self) -> Tensor:
        """The lower one of two in the middle."""
        return Tensor(np.sort(self.array, axis=None)[(self.array.size - 1) // 2])

    def norm(self, dim: Any = EVERY_DIM, keepdim: object = False) -> Tensor:
        return Tensor(np.sqrt(np.sum(np.square(self.array), axis=dim, keepdims=keepdim)))  # type: ignore[call-overload]

    def round(self, decimals: Whole = 0) -> Tensor:
        return Tensor(np.round(self.array, decimals))

    def clamp(self, min: Any = None, max: Any = None) -> Tensor:
        result = self if min is None else maximum(self, min)
        return result if max is None else minimum(result, max)

    def nan_to_num(self, nan: Real = 0.0) -> Tensor:
        return Tensor(np.nan_to_num(self.array, nan=nan))

    def cumsum(self, dim: Whole) -> Tensor:
        return Tensor(np.cumsum(self.array, axis=dim))

    def diff(self, dim: Whole = -1, prepend: Tensor | None = None) -> Tensor:
        whole = self.array if prepend is None else np.concatenate((prepend.array, self.array), dim)
        return Tensor(np.diff(whole, axis=dim))


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
        return Tensor(_own(data)).to(dtype)
    return tensor(data, dtype)


def from_numpy(array: np.ndarray) -> Tensor:
    return Tensor(array)


def zeros(*sizes: Any, dtype: Any = float32, device: object = None) -> Tensor:
    return Tensor(np.zeros(_dims(sizes), dtype))


def ones(*sizes: Any, dtype: Any = float32, device: object = None) -> Tensor:
    return Tensor(np.ones(_dims(sizes), dtype))


empty = zeros


def full(size: Any, value: Any, dtype: Any = None, device: object = None) -> Tensor:
    return Tensor(np.full(size, _own(value), tensor(value).dtype if dtype is None else dtype))


def eye(n: int, dtype: Any = float32, device: object = None) -> Tensor:
    return Tensor(np.eye(n, dtype=dtype))


def arange(*ends: Any, dtype: Any = None, device: object = None) -> Tensor:
    is_whole = not any(isinstance(end, float) for end in ends)
    return Tensor(np.arange(*map(_own, ends), dtype=dtype or (int64 if is_whole else float32)))


def linspace(first: Any, last: Any, n: int, dtype: Any = float32, device: object = None) -> Tensor:
    return Tensor(np.linspace(_own(first), _own(last), n, dtype=dtype))


def zeros_like(like: Tensor, dtype: Any = None, **_: object) -> Tensor:
    return Tensor(np.zeros(like.shape, dtype or like.dtype))


def ones_like(like: Tensor, dtype: Any = None) -> Tensor:
    return Tensor(np.ones(like.shape, dtype or like.dtype))


empty_like = zeros_like


def full_like(like: Tensor, value: Any, dtype: Any = None) -> Tensor:
    return Tensor(np.full(like.shape, _own(value), dtype or like.dtype))


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
    return Tensor(np.where(condition.array, *_pair(first, second)))


def minimum(first: Tensor, second: Any) -> Tensor:
    return Tensor(np.minimum(*_pair(first, second)))


def maximum(first: Tensor, second: Any) -> Tensor:
    return Tensor(np.maximum(*_pair(first, second)))


def broadcast_tensors(*tensors: Tensor) -> tuple[Tensor, ...]:
    shape = np.broadcast_shapes(*(each.array.shape for each in tensors))
    return tuple(each.expand(*shape) for each in tensors)


def broadcast_shapes(*shapes: tuple[int, ...]) -> Size:
    return Size(np.broadcast_shapes(*shapes))


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

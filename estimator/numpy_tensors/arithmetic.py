"""Number formats of torch, and arithmetic of tensors on NumPy in them."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

float64, float32 = np.dtype(np.float64), np.dtype(np.float32)
int64 = np.dtype(np.int64)
bool = np.dtype(np.bool_)
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

    values: Any
    indices: Any


def dims(sizes: tuple[Any, ...]) -> tuple[int, ...]:
    """Lengths that were given one by one or in one sequence."""
    whole = sizes[0] if len(sizes) == 1 and isinstance(sizes[0], Sequence) else sizes
    return tuple(int(size) for size in whole)


def own(value: Any) -> Any:
    """What NumPy takes for a tensor, or for anything with tensors in it."""
    if isinstance(value, Arithmetic):
        return value.array
    return tuple(map(own, value)) if isinstance(value, tuple) else value


def _real(array: np.ndarray) -> np.ndarray:
    """Whole numbers as what a function with fractions makes of them."""
    return array if array.dtype.kind in "fc" else array.astype(float32)


def pair(first: Any, second: Any) -> tuple[Any, Any]:
    """Operands in the format in which torch combines them: numbers without an axis, and those of Python, give way to arrays."""
    x, y = own(first), own(second)
    if getattr(x, "dtype", None) is getattr(y, "dtype", first):
        return x, y
    if not isinstance(x, np.ndarray):
        y, x = pair(second, first)
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
        return type(self)(function(*pair(self, other)))

    return apply


def _backward(function: Callable[..., Any]) -> Callable[[Any, Any], Any]:
    def apply(self: Any, other: Any) -> Any:
        y, x = pair(self, other)
        return type(self)(function(x, y))

    return apply


def _in_place(function: Callable[..., Any]) -> Callable[[Any, Any], Any]:
    def apply(self: Any, other: Any) -> Any:
        self.array[...] = function(*pair(self, other))
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
        return type(self)(function(_real(self.array) if is_real else self.array))

    return apply


def _reduced(function: Callable[..., Any]) -> Callable[..., Any]:
    def apply(self: Any, dim: Any = EVERY_DIM, keepdim: object = False) -> Any:
        axis = tuple(dim) if isinstance(dim, list) else dim
        return type(self)(function(self.array, axis=axis, keepdims=keepdim))

    return apply


def _extreme(
    each: Callable[..., Any], best: Callable[..., Any], where: Callable[..., Any]
) -> Callable[..., Any]:
    def apply(self: Any, dim: Any = EVERY_DIM, keepdim: object = False) -> Any:
        if dim is EVERY_DIM:
            return type(self)(best(self.array))
        if isinstance(dim, Arithmetic):
            return type(self)(each(*pair(self, dim)))
        places = where(self.array, axis=dim, keepdims=True)
        values = np.take_along_axis(self.array, places, dim)
        both = (values, places) if keepdim else (values.squeeze(dim), places.squeeze(dim))
        return WithIndices(*map(type(self), both))

    return apply


def of(function: Callable[..., Any]) -> Callable[..., Any]:
    """A method that is a function of NumPy with the same further arguments; `dim` may be named."""

    def apply(self: Any, *more: Any, dim: Any = EVERY_DIM) -> Any:
        along = {} if dim is EVERY_DIM else {"axis": dim}
        return type(self)(function(self.array, *map(own, more), **along))

    return apply


def by_dims(function: Callable[..., Any]) -> Callable[..., Any]:
    """A method that is a function of NumPy of lengths, which are given one by one or in one sequence."""

    def apply(self: Any, *sizes: Any) -> Any:
        return type(self)(function(self.array, dims(sizes)))

    return apply


class Arithmetic:
    """Numbers in an `array`: operators, functions of each number, and of all along an axis."""

    __slots__ = ("array",)
    __array_priority__ = 1000.0  # or NumPy would take its own operators for them
    __hash__ = object.__hash__

    def __init__(self, array: Any) -> None:
        self.array = np.asarray(array)

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

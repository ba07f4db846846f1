"""The class that stands for `torch.Tensor`."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from estimator.numpy_tensors.arithmetic import (
    EVERY_DIM,
    Arithmetic,
    Real,
    Size,
    Whole,
    WithIndices,
    bool,
    by_dims,
    device,
    dims,
    float64,
    int64,
    of,
    own,
    pair,
)

lacking: list[str] = []


class Tensor(Arithmetic):
    """Numbers, whose operations are those of `torch.Tensor`."""

    __slots__ = ()
    requires_grad, is_cuda, device = False, False, device()

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
        return Tensor(self.array[own(key)])

    def __setitem__(self, key: Any, value: Any) -> None:
        self.array[own(key)] = own(value)

    def itself(self, *_: object, **__: object) -> Tensor:
        """These numbers: they lie on the processor and carry no derivatives."""
        return self

    detach = cpu = itself
    clone, transpose, movedim = of(np.ndarray.copy), of(np.swapaxes), of(np.moveaxis)
    reshape, repeat, flip = by_dims(np.reshape), by_dims(np.tile), by_dims(np.flip)
    roll, repeat_interleave, cumsum = of(np.roll), of(np.repeat), of(np.cumsum)

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
        return Tensor(np.array(own(data)).astype(self.dtype))

    def new_zeros(self, *sizes: Any) -> Tensor:
        return Tensor(np.zeros(dims(sizes), self.dtype))

    def new_ones(self, *sizes: Any) -> Tensor:
        return Tensor(np.ones(dims(sizes), self.dtype))

    def stride(self) -> tuple[int, ...]:
        return tuple(step // self.array.itemsize for step in self.array.strides)

    def expand(self, *sizes: Any) -> Tensor:
        sizes = dims(sizes)
        here = (1,) * (len(sizes) - self.ndim) + self.array.shape
        wanted = tuple(n if size == -1 else size for size, n in zip(sizes, here, strict=True))
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

    def diagonal(self, dim1: Whole = 0, dim2: Whole = 1) -> Tensor:
        return Tensor(np.diagonal(self.array, axis1=dim1, axis2=dim2))

    # Places.

    nonzero, take_along_dim = of(np.argwhere), of(np.take_along_axis)
    isin, bincount = of(np.isin), of(np.bincount)

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

    def scatter_reduce(self, dim: Whole, index: Tensor, source: Tensor, how: str) -> Tensor:
        assert (dim, self.ndim) == (0, 1)
        result = self.array.copy()
        {"amin": np.minimum, "amax": np.maximum, "sum": np.add}[how].at(result, index.array, source.array)
        return Tensor(result)

    def masked_fill(self, mask: Tensor, value: Any) -> Tensor:
        return Tensor(np.where(mask.array, np.asarray(value, self.dtype), self.array))

    def where(self, condition: Any, other: Any) -> Tensor:
        return Tensor(np.where(condition.array, *pair(self, other)))

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

    def searchsorted(self, values: Tensor, right: object = False) -> Tensor:
        return Tensor(np.searchsorted(self.array, values.array, "right" if right else "left"))

    def cummax(self, dim: Whole) -> Any:
        return SimpleNamespace(values=Tensor(np.maximum.accumulate(self.array, axis=dim)))

    # Numbers of them.

    def std(self) -> Tensor:
        return Tensor(np.std(self.array, ddof=1))

    def median(self) -> Tensor:
        """The lower one of two in the middle."""
        return Tensor(np.sort(self.array, axis=None)[(self.array.size - 1) // 2])

    def nanmedian(self, dim: Whole) -> SimpleNamespace:
        """The lower one of two in the middle, of those that are numbers; nan where none is."""
        in_order = np.sort(self.array, axis=dim)  # numbers first
        n = np.sum(~np.isnan(in_order), axis=dim, keepdims=True)
        middle = np.take_along_axis(in_order, np.maximum(n - 1, 0) // 2, axis=dim)
        return SimpleNamespace(values=Tensor(np.squeeze(middle, axis=dim)))

    def norm(self, dim: Any = EVERY_DIM, keepdim: object = False) -> Tensor:
        return Tensor(np.sqrt(np.sum(np.square(self.array), axis=dim, keepdims=keepdim)))  # type: ignore[call-overload]

    def round(self, decimals: Whole = 0) -> Tensor:
        return Tensor(np.round(self.array, decimals))

    def clamp(self, min: Any = None, max: Any = None) -> Tensor:
        result = self if min is None else self.maximum(min)
        return result if max is None else result.minimum(max)

    def nan_to_num(self, nan: Real = 0.0) -> Tensor:
        return Tensor(np.nan_to_num(self.array, nan=nan))

    def diff(self, dim: Whole = -1, prepend: Tensor | None = None) -> Tensor:
        whole = self.array if prepend is None else np.concatenate((prepend.array, self.array), dim)
        return Tensor(np.diff(whole, axis=dim))

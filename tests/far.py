"""A device that no computer has, to test where tensors are made.

Its tensors hold their numbers on the processor, so everything runs and gives real numbers: loops that stop by a value, distinct rows, fits.
torch sees another device though. As on a graphics processor, an operation refuses a tensor of the processor beside them, unless it is a single
number that it does not join to others, and NumPy takes none. `docs/decisions/0048` says why torch's own fake tensors do not serve here.

Where COILCAL_FAR_DEVICE names a real one, such as cuda, the tests take that instead (`make test-device`).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing
from torch.utils._pytree import tree_leaves, tree_map, tree_map_only
from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

REAL = os.environ.get("COILCAL_FAR_DEVICE")
if not REAL:  # once a device is made up, torch takes no derivatives on a real one
    _setup_privateuseone_for_python_backend("far")
FAR = torch.device(REAL or "far", 0)
NEAR = torch.device("cpu")
JOINS = (torch.ops.aten.cat.default, torch.ops.aten.stack.default)
MOVES = (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)


class FarTensor(torch.Tensor):
    """A tensor of the far device; `near` holds its numbers."""

    near: torch.Tensor

    @staticmethod
    def __new__(cls, near: torch.Tensor) -> FarTensor:
        made = torch.Tensor._make_wrapper_subclass(
            cls,
            near.size(),
            strides=near.stride(),
            storage_offset=near.storage_offset(),
            dtype=near.dtype,
            device=FAR,
        )
        made.near = near
        return made

    __torch_function__ = torch._C._disabled_torch_function_impl

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})

    def __repr__(self) -> str:
        return f"far {self.near!r}"


class TensorOfTheProcessor(RuntimeError):
    """An operation among far tensors was given one of the processor."""


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
    is_far = any(isinstance(tensor, FarTensor) for tensor in tensors)
    if is_far and func not in MOVES:
        strays = [
            tuple(t.shape) for t in tensors if not isinstance(t, FarTensor) and (t.dim() or func in JOINS)
        ]
        if strays:
            raise TensorOfTheProcessor(f"{func}: shape {strays[0]}")
    near_args, near_kwargs = tree_map(lambda t: t.near if isinstance(t, FarTensor) else t, (args, kwargs))
    if kwargs.get("device") is not None:
        is_far = torch.device(kwargs["device"]).type == FAR.type
        near_kwargs["device"] = NEAR
    elif func in MOVES:
        is_far = isinstance(args[0], FarTensor)
    made = func(*near_args, **near_kwargs)
    if not is_far:
        return made
    made = tree_map(lambda t: FarTensor(t) if isinstance(t, torch.Tensor) else t, made)
    return return_and_correct_aliasing(func, args, kwargs, made)


class _Factories(TorchDispatchMode):
    """Operations that make tensors from none."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


class _FromNumbers(TorchFunctionMode):
    """What torch does in C++ without passing through the dispatcher: tensors from numbers, and numbers from tensors."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if func in (torch.tensor, torch.as_tensor) and kwargs.get("device") is not None:
            device = kwargs["device"]
            return func(*args, **{**kwargs, "device": NEAR}).to(device)
        if args and isinstance(args[0], FarTensor):
            if func is torch.Tensor.tolist:
                return args[0].near.tolist()
            if func is torch.Tensor.numpy:
                raise TypeError("can't convert far:0 device type tensor to numpy")
            if func is torch.Tensor.new_tensor:
                return torch.tensor(args[1], dtype=kwargs.get("dtype", args[0].dtype)).to(FAR)
            if func in (torch.Tensor.__getitem__, torch.Tensor.__setitem__):
                # Of lists of rows torch makes tensors where it needs them.
                rows = tree_map_only(list, _rows, args[1], is_leaf=lambda i: isinstance(i, list))
                return func(args[0], rows, *args[2:])
            if func is torch.bincount:  # which has no implementation for other devices
                return torch.bincount(args[0].near, *args[1:], **kwargs).to(FAR)
        return func(*args, **kwargs)


def _rows(numbers: list[int]) -> torch.Tensor:
    return torch.tensor(numbers, dtype=None if numbers else torch.int64).to(FAR)


@contextmanager
def far_device() -> Iterator[torch.device]:
    """The device, on which tensors can be made inside."""
    if REAL:
        yield FAR
        return
    # The modes hold in this thread only.
    with _Factories(), _FromNumbers(), patch("estimator.side_by_side.n_cores", return_value=1):
        yield FAR

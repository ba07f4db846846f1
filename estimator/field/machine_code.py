"""Functions in machine code, and which numbers they take.

numba translates a function when it is first called on a machine and keeps it on disk (`docs/decisions/0005`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from estimator.tensors import Tensor, is_on_numpy, torch

FEW_TERMS = 2**23  # loops times points; NumPy sums them in hardly more time than numba takes to load
_so_far = {"terms": 0}  # summed without machine code


def is_plain(*tensors: Tensor) -> bool:
    """Whether tensors are numbers that the kernels take: on the processor, in double precision, and without derivatives.

    Examples:
        >>> one = torch.ones(3, dtype=torch.float64)
        >>> is_plain(one), is_plain(one.float()), is_plain(one.clone().requires_grad_())
        (True, False, False)
    """
    return all(
        tensor.device.type == "cpu" and tensor.dtype == torch.float64 and not has_derivatives(tensor)
        for tensor in tensors
    )


def pays(n_terms: int) -> bool:
    """Whether machine code is worth its start for so many loops times points, after all before them; beside torch's start it always is.

    Examples:
        >>> pays(1)
        True
    """
    if is_on_numpy():
        _so_far["terms"] += n_terms
    return _so_far["terms"] > FEW_TERMS or not is_on_numpy()


def has_derivatives(tensor: Tensor) -> bool:
    """Whether a tensor carries derivatives of any kind, which kernels do not."""
    return (
        (tensor.requires_grad and torch.is_grad_enabled())
        or torch._C._functorch.is_functorch_wrapped_tensor(tensor)
        or torch.autograd.forward_ad.unpack_dual(tensor).tangent is not None
    )


def array_of(tensor: Tensor) -> np.ndarray:
    """Numbers of a tensor, one after another in memory."""
    return tensor.detach().contiguous().numpy()


def machine_code(function: Callable[..., None], is_in_order: bool = True) -> MachineCode:
    """Machine code of a function, made or read when it is first called.

    Args:
        function: What is translated.
        is_in_order: Sums are added in the order in which they are written, not several terms at a time.
    """
    # A product and a sum may become one instruction, which rounds once.
    return MachineCode(function, {"contract"} if is_in_order else {"contract", "reassoc", "nsz"})


class MachineCode:
    """A function that numba translates when it is first called, and keeps on disk where a folder for it can be written.

    numba takes a quarter of a second to load, and a third one for the first call, which commands that compute little do without.

    Args:
        function: What is translated.
        fastmath: What the compiler may change of the order and rounding of operations.
    """

    def __init__(self, function: Callable[..., None], fastmath: set[str]) -> None:
        self._function, self._fastmath = function, fastmath

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        return self._translated(*arguments)

    @cached_property
    def _translated(self) -> Any:
        import numba

        plain = inspect.unwrap(self._function)  # without the checks of shapes that tests put around it
        settings: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": self._fastmath}
        try:
            return numba.njit(cache=True, **settings)(plain)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            return numba.njit(**settings)(plain)

    @property
    def _numba_type_(self) -> Any:  # numba asks for it where a translated function calls this one
        return self._translated._numba_type_

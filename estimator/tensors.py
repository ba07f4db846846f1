"""`torch` and its `Tensor`, by names that load it when it is first used: it alone takes over a second and 200 MB.

Modules that declare what commands without tensors read, such as rigs and causes, take both from here: `from estimator.tensors import
Tensor, torch`. Such a module computes nothing with torch while it is imported: no constant is a tensor, no default a dtype. Modules of fits
import torch itself.

A command that takes no derivative calls `compute_on_numpy` and never loads torch: `torch` and `Tensor` then stand for
`estimator.numpy_tensors`. The formulas are the same ones.

`importlib.util.LazyLoader` would put an unloaded torch into `sys.modules`, where SciPy looks for one, and loads it.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

__all__ = ["Tensor", "compute_on_numpy", "is_on_numpy", "lacking", "torch"]

if TYPE_CHECKING:
    import torch
    from torch import Tensor
else:

    class _WhenUsed:
        """A module of that name, imported at the first use of anything in it."""

        def __init__(self, name: str) -> None:
            self._name = name

        def __getattr__(self, name: str) -> Any:
            value = getattr(import_module(self._name), name)
            setattr(self, name, value)  # from now on it costs what an attribute of a module does
            return value

    class _TensorType(type):
        """Says what is a tensor: nothing before torch is loaded."""

        def __instancecheck__(cls, instance: object) -> bool:
            return torch._name in sys.modules and isinstance(instance, torch.Tensor)

        def __subclasscheck__(cls, subclass: type) -> bool:
            return torch._name in sys.modules and issubclass(subclass, torch.Tensor)

    class Tensor(metaclass=_TensorType):
        """Stands for `torch.Tensor` in annotations and in `isinstance`."""

    torch = _WhenUsed("torch")


def compute_on_numpy() -> bool:
    """Let `torch` and `Tensor` stand for `estimator.numpy_tensors` from now on, unless torch is loaded; says whether they do."""
    if "torch" in sys.modules:
        return False
    cast(Any, torch)._name = "estimator.numpy_tensors"
    return True


def is_on_numpy() -> bool:
    """Whether NumPy stands for torch."""
    return getattr(torch, "_name", "torch") != "torch"


def lacking() -> list[str]:
    """A function of torch that the substitute on NumPy lacks."""
    numpy_tensors = sys.modules.get("estimator.numpy_tensors")
    return [] if numpy_tensors is None else list(numpy_tensors.lacking)

"""Devices of tensors and their precision: names that users give, and the border to NumPy.

Readings are moved to a device and into a precision (`Observations.to`); what is computed from them follows. emcee, ArviZ, SciPy and all
reports stay on the processor.
"""

from __future__ import annotations

import numpy as np

from estimator.errors import InvalidInput, quoted
from estimator.tensors import Tensor, torch

PRECISIONS = {"double": torch.float64, "single": torch.float32}


def device_named(name: str) -> torch.device:
    """The device of that name.

    Raises:
        InvalidInput: torch knows no such device, or cannot compute on it here.
    Examples:
        >>> device_named("cpu")
        device(type='cpu')
        >>> device_named("gpu")
        Traceback (most recent call last):
        estimator.errors.InvalidInput: device must be one that torch can compute on here, such as cpu; received 'gpu'
    """
    try:
        device = torch.device(name)
        torch.ones(1, dtype=torch.float64, device=device).sum().item()
    except (RuntimeError, AssertionError, TypeError) as error:
        raise InvalidInput(
            f"device must be one that torch can compute on here, such as cpu; received {quoted(name)}"
        ) from error
    return device


def precision_named(name: str) -> torch.dtype:
    """The number format of a precision.

    Raises:
        InvalidInput: There is no such precision.
    """
    if name not in PRECISIONS:
        raise InvalidInput(f"precision must be one of {', '.join(PRECISIONS)}; received {quoted(name)}")
    return PRECISIONS[name]


def numpy_of(values: Tensor) -> np.ndarray:
    """Numbers of a tensor without derivatives for NumPy, from any device."""
    return values.detach().cpu().numpy()

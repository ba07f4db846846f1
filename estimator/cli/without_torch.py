"""Commands that take no derivative compute on NumPy: loading torch takes longer than all the rest of them.

Where NumPy lacks something, or causes of another package take torch by themselves, the command runs once more, with torch.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from estimator.errors import CoilcalError
from estimator.tensors import compute_on_numpy, lacking

WITH_TORCH = "COILCAL_WITH_TORCH"  # a variable that tells the second run what it is, and may tell the first


def is_numpy_enough(parameters: Mapping[str, Any]) -> bool:
    """Whether a command that takes no derivative computes on NumPy.

    Args:
        parameters: Of the command: a device or a precision that NumPy has not asks for torch.
    """
    is_plain = (parameters.get("device", "cpu"), parameters.get("precision", "double")) == ("cpu", "double")
    return is_plain and WITH_TORCH not in os.environ


@contextmanager
def on_numpy(parameters: Mapping[str, Any]) -> Iterator[None]:
    """Let a command with these parameters compute on NumPy, and run it once more with torch where it cannot."""
    if not is_numpy_enough(parameters) or not compute_on_numpy():
        yield
        return
    try:
        yield
    except (click.ClickException, click.exceptions.Exit, BrokenPipeError):
        raise
    except Exception as error:
        if isinstance(error, CoilcalError | OSError) and not lacking():
            raise
        sys.exit(subprocess.call(sys.orig_argv, env={**os.environ, WITH_TORCH: "1"}))

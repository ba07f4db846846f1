"""`estimator.tensors`: names of torch that load nothing before they are used, and then are torch's own."""

from __future__ import annotations

import subprocess
import sys

import torch as loaded

from estimator.tensors import Tensor, torch

BEFORE = """
import sys
from estimator.tensors import Tensor, torch
assert not isinstance([1.0], Tensor) and not issubclass(list, Tensor)
assert "torch" not in sys.modules
assert isinstance(torch.ones(1), Tensor)
assert "torch" in sys.modules
"""


def test_nothing_is_loaded_before_something_is_computed():
    subprocess.run([sys.executable, "-c", BEFORE], check=True)


def test_names_are_those_of_torch():
    assert torch.float64 is loaded.float64
    assert torch.linalg is loaded.linalg
    assert torch.Tensor is loaded.Tensor
    assert isinstance(loaded.ones(1), Tensor)
    assert issubclass(loaded.nn.Parameter, Tensor)
    assert not isinstance(1.0, Tensor)

"""The yardstick in C: the same numbers as machine code by numba, and a sentence where there is no compiler."""

from __future__ import annotations

import numpy as np
import pytest

from scripts.benchmarks import kernel


def test_c_by_hand_and_coilcal_sum_the_same_loops(tmp_path):
    libraries = kernel.by_hand(tmp_path)
    if not libraries:
        pytest.skip("no C compiler for vector instructions")
    by_name = kernel.functions(libraries, steps=5)
    ours = by_name["coilcal, value"]()
    for name in libraries:
        # Rounding of 64 loops, whose fields add up with one sign along z.
        np.testing.assert_allclose(by_name[name](), ours, rtol=1e-13, atol=1e-14 * np.abs(ours).max())

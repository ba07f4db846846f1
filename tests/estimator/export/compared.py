"""Numbers of another program beside those of the calibration that it came from."""

from __future__ import annotations

import numpy as np
from torch import Tensor

ROUNDING = 1e-9  # of the field at a point; sums and poses are rounded in another order


def assert_close(received: np.ndarray, expected: Tensor) -> None:
    """Equal to rounding relative to the size at each point, NaN at the same points."""
    size = expected.flatten(1).norm(dim=1).numpy()
    error = np.linalg.norm((received - expected.flatten(1).numpy()), axis=1)
    np.testing.assert_array_equal(np.isnan(error), np.isnan(size))
    assert np.nanmax(error / size) < ROUNDING

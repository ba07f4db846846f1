"""Field and gradient on a grid as CSV: any model, iron and corrections included."""

from __future__ import annotations

import csv
import io
import math

import numpy as np

from estimator.export.request import Request

# The other entries follow: the gradient is symmetric and traceless.
ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2))
HEADER = (
    *(f"{axis}_m" for axis in "xyz"),
    *(f"B{axis}_T" for axis in "xyz"),
    *(f"dB{'xyz'[i]}_d{'xyz'[j]}_T_per_m" for i, j in ENTRIES),
)


def grid_csv(request: Request) -> str:
    """The text of the file: a row for each point, z fastest; points inside a winding have no field.

    Raises:
        InvalidInput: No grid, no currents, or what `Calibration.field` refuses.
    """
    grid, field_T, gradient = request.on_grid()
    entries = np.stack([gradient[..., i, j] for i, j in ENTRIES], axis=-1).reshape(-1, len(ENTRIES))
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(HEADER)
    for row in np.concatenate((grid.points_m.numpy(), field_T.reshape(-1, 3), entries), axis=1).tolist():
        writer.writerow([repr(number) if math.isfinite(number) else "" for number in row])
    return buffer.getvalue()

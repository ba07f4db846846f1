"""Field and gradient on a grid as CSV: any model, iron and corrections included."""

from __future__ import annotations

import csv
import io
import math

import torch

from estimator.export.request import Request

ENTRIES = (
    (0, 0),
    (0, 1),
    (0, 2),
    (1, 1),
    (1, 2),
)  # the others follow: the gradient is symmetric and traceless
HEADER = (
    *(f"{axis}_m" for axis in "xyz"),
    *(f"B{axis}_T" for axis in "xyz"),
    *(f"dB{'xyz'[i]}_d{'xyz'[j]}_T_per_m" for i, j in ENTRIES),
)
BLOCK = 10_000  # points evaluated at once


def grid_csv(request: Request) -> str:
    """The text of the file: a row for each point, z fastest; points inside a winding have no field.

    Raises:
        InvalidInput: No grid, no currents, or what `Calibration.field` refuses.
    """
    points_m = request.points().points_m
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(HEADER)
    for block_m in points_m.split(BLOCK):
        field_T, gradient = request.field_and_gradient(block_m)
        entries = torch.stack([gradient[:, i, j] for i, j in ENTRIES], dim=1)
        for row in torch.cat((block_m, field_T, entries), dim=1).tolist():
            writer.writerow([repr(number) if math.isfinite(number) else "" for number in row])
    return buffer.getvalue()

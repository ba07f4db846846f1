"""Points on a grid in the world frame, from options such as --grid x_mm=-50:50:11."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from estimator.errors import InvalidInput

if TYPE_CHECKING:
    import numpy as np

MOST_POINTS = 1_000_000


def grid_axes(texts: Sequence[str]) -> dict[str, np.ndarray]:
    """Coordinates along x, y and z in metres; an axis that is not named has the one coordinate 0.

    Raises:
        InvalidInput: A text of another form, an axis named twice, or too many points.
    """
    import numpy as np

    grid = [_axis(text) for text in texts]
    if len({name for name, _ in grid}) < len(grid):
        raise InvalidInput(f"--grid must name an axis once; received {', '.join(texts)}")
    n_points = math.prod(len(coordinates_m) for _, coordinates_m in grid)
    if n_points > MOST_POINTS:
        raise InvalidInput(
            f"--grid must have at most {MOST_POINTS} points; received {n_points} ({', '.join(texts)})"
        )
    return {"x": np.zeros(1), "y": np.zeros(1), "z": np.zeros(1), **dict(grid)}


def _axis(text: str) -> tuple[str, np.ndarray]:
    """Parse an option --grid into the axis and its coordinates in metres."""
    import numpy as np

    from estimator.units import split_unit
    from estimator.yaml_section import LARGEST

    key, _, span = text.partition("=")
    name, unit = split_unit(key)
    parts = span.split(":")
    try:
        numbers = [float(part) for part in parts]
        count = int(parts[2]) if len(parts) == 3 else 1
    except ValueError:
        numbers, count = [], 0
    if (
        unit is None
        or unit.dimension != "length"
        or name not in ("x", "y", "z")
        or len(numbers) not in (1, 3)
        or count < 1
        or not np.isfinite(numbers).all()
    ):
        raise InvalidInput(f"--grid must look like x_mm=-50:50:11 or z_mm=20; received {text!r}")
    if count > MOST_POINTS or max(map(abs, numbers[:2])) > LARGEST:
        raise InvalidInput(
            f"--grid must have at most {MOST_POINTS} points within {LARGEST:g} of 0; received {text!r}"
        )
    return name, np.linspace(numbers[0], numbers[-2 if len(numbers) == 3 else 0], count) * unit.to_si

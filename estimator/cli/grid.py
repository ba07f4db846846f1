"""Points on a grid in the world frame, from options such as --grid x_mm=-50:50:11."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from estimator.errors import InvalidInput, quoted

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


def grid_words(axes_m: Mapping[str, np.ndarray]) -> str:
    """Description of a grid, for users who took the number of points for a step.

    Examples:
        >>> import numpy as np
        >>> grid_words({"x": np.linspace(-0.02, 0.02, 5), "y": np.zeros(1), "z": np.full(1, 0.01)})
        'x -20 to 20 mm in 5 points, 10 mm apart; y 0 mm; z 10 mm'
    """
    words = []
    for name, coordinates_m in axes_m.items():
        first, last, n = 1e3 * coordinates_m[0], 1e3 * coordinates_m[-1], len(coordinates_m)
        step = f" in {n} points, {abs(last - first) / (n - 1):.4g} mm apart" if n > 1 else ""
        words.append(f"{name} {first:.6g} to {last:.6g} mm{step}" if n > 1 else f"{name} {first:.6g} mm")
    return "; ".join(words)


def _axis(text: str) -> tuple[str, np.ndarray]:
    """Parse an option --grid into the axis and its coordinates in metres."""
    import numpy as np

    from estimator.units import LARGEST, split_unit

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
        raise InvalidInput(
            f"--grid must look like x_mm=-50:50:11, which is 11 points from -50 to 50, or z_mm=20; received {quoted(text)}"
        )
    if count > MOST_POINTS or max(map(abs, numbers[:2])) > LARGEST:
        raise InvalidInput(
            f"--grid must have at most {MOST_POINTS} points within {LARGEST:g} of 0; received {quoted(text)}"
        )
    return name, np.linspace(numbers[0], numbers[-2 if len(numbers) == 3 else 0], count) * unit.to_si

"""Whether what looks like a listed cause changes with time, place or current as that cause would not.

Something else that resembles a cause in these readings hardly resembles it everywhere. What is left beside all that leads is then like the
change by the cause times a smooth function.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.devices import numpy_of
from estimator.diagnosis import policy
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.halves import order_and_places
from estimator.effects.use import as_meant

MOST_CURRENTS = 2  # whose coils are asked


def evidence_of_relatives(asked: Asked, item: int) -> float:
    """Log Bayes factor of the change by an item being stronger here and weaker there, beside all that leads.

    The largest over the circumstances: time and its square, each coordinate of each mover, and currents.

    Args:
        asked: The readings at one expansion.
        item: Number of a listed item, in the leading set or not.
    References: Rao, Proc. Camb. Phil. Soc. 44, 50 (1948): the score of a parameter at its null, here with a prior.
    """
    products, dictionary, always = asked.slots.products, asked.dictionary, asked.expansion.always
    chosen = [*(i for i in asked.leading if i != item), item]
    sizes = products.sizes(chosen, asked.noise)[0].to(dictionary.columns)
    numbers, widths, _ = products.of(chosen)
    columns, widths = numbers.tolist(), widths.to(sizes)
    change = dictionary.changed([item], sizes[len(sizes) - len(dictionary.items[item].columns) :])
    changed = always.rest(change[:, None] * _circumstances(asked)) / asked.noise
    of_chosen = always.rest(dictionary.columns[:, columns]) * (widths / asked.noise)
    left = always.rest(dictionary.residual - dictionary.changed(chosen, sizes)) / asked.noise
    precision = of_chosen.T @ of_chosen + torch.eye(len(columns)).to(of_chosen)
    followed = torch.linalg.solve(precision, of_chosen.T @ changed)
    square = ((changed - of_chosen @ followed) * changed).sum(0)
    variance = 1.0 + policy.RELATIVE_WIDTH**2 * square
    gains = 0.5 * (policy.RELATIVE_WIDTH * (changed.T @ left)) ** 2 / variance - 0.5 * torch.log(variance)
    return float(gains.max())


def _circumstances(asked: Asked) -> Float[Tensor, "component circumstance"]:
    """Time, its square, places of movers and currents, each with mean 0 and of size 1, component by component."""
    fit = asked.expansion.plain
    readings = as_meant(fit.rig, fit.observations)
    order, *places = order_and_places(readings, fit.rig)
    currents = numpy_of(readings.current_A).T[:MOST_CURRENTS]
    by_reading = _standard([order, order**2, *places, *currents])
    each: Tensor = torch.from_numpy(np.repeat(by_reading, 3, axis=0)).to(fit.predicted_T)
    return each[readings.is_measured.flatten()]


def _standard(columns: Sequence[np.ndarray]) -> Float[np.ndarray, "reading circumstance"]:
    """Columns with mean 0 and standard deviation 1, without those that do not vary."""
    matrix = np.column_stack(columns)
    matrix = matrix - matrix.mean(0)
    spread = matrix.std(0)
    return matrix[:, spread > 0.0] / spread[spread > 0.0]
